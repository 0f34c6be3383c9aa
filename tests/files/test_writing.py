"""A file has its old or its new content, whatever happens while it is written."""

import errno
import os
import random
import stat

import pytest

from ikservo.files.writing import (
    FileWriteError,
    check_writable,
    remove_durably,
    write_all_atomic,
    write_atomic,
)
from tests.files.power_cuts import FailingCall, PowerCut, PowerSupply, patch_calls, restore_calls

OLD, NEW = "the old text\n" * 50, "the new text, which is longer\n" * 80


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "arms" / "so101.toml"
    write_atomic(path, OLD)
    return path


def test_write_atomic_creates_missing_parent_folders(tmp_path):
    write_atomic(tmp_path / "a" / "b" / "c.toml", NEW)
    assert (tmp_path / "a" / "b" / "c.toml").read_text() == NEW


def test_atomic_write_keeps_old_file_as_backup(path):
    write_atomic(path, NEW, keep_old=True)
    assert path.read_text() == NEW
    assert path.with_name("so101.toml.bak").read_text() == OLD


def test_atomic_write_does_not_leave_other_files_in_folder(path):
    write_atomic(path, NEW)
    assert [p.name for p in path.parent.iterdir()] == ["so101.toml"]


@pytest.mark.skipif(os.name != "posix", reason="modes of files")
def test_atomic_write_keeps_usual_and_private_permissions(path):
    """A new file gets the user's umask, a replaced one keeps its mode, a key is private."""
    by_hand = path.with_name("by_hand")
    by_hand.touch()
    assert path.stat().st_mode == by_hand.stat().st_mode
    path.chmod(0o660)
    write_atomic(path, NEW, keep_old=True)
    write_atomic(key := path.with_name("key.pem"), NEW, private=True)
    backup = path.with_name("so101.toml.bak")
    modes = [stat.S_IMODE(each.stat().st_mode) for each in (path, backup, key)]
    assert modes == [0o660, 0o660, 0o600]


@pytest.mark.skipif(os.name != "posix", reason="modes of files")
def test_atomic_write_works_on_disk_without_permissions(path, monkeypatch):
    """FAT and network disks refuse permissions; private content is never readable meanwhile."""
    path.chmod(0o600)
    seen, write = [], os.write

    def refuse(*_):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    def look(handle, data):
        seen.append(stat.S_IMODE(os.fstat(handle).st_mode))
        return write(handle, data)

    monkeypatch.setattr(os, "fchmod", refuse)
    monkeypatch.setattr(os, "write", look)
    write_atomic(path, NEW)
    assert path.read_text(encoding="utf-8") == NEW
    assert seen == [0o600]


def calls_of_a_save(path, monkeypatch):
    power = PowerSupply().limit_files(monkeypatch)
    write_atomic(path, NEW, keep_old=True)
    restore_calls(monkeypatch)
    write_atomic(path, OLD)
    return power.spent


def test_power_cut_at_any_write_call_leaves_old_or_new_file(path, monkeypatch):
    calls = calls_of_a_save(path, monkeypatch)
    assert calls >= 12  # of two files: made, written, synced, closed, renamed; folder synced
    seen = set()
    for lasts in range(calls):
        PowerSupply(lasts).limit_files(monkeypatch)
        with pytest.raises(PowerCut):
            write_atomic(path, NEW, keep_old=True)
        restore_calls(monkeypatch)
        assert path.read_text() in (OLD, NEW)
        seen.add(path.read_text())
        write_atomic(path, OLD)
    assert seen == {OLD, NEW}


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EROFS], ids=errno.errorcode.get)
def test_disk_error_tells_whether_file_was_changed(path, monkeypatch, number):
    calls = calls_of_a_save(path, monkeypatch)
    for nth in range(1, calls + 1):
        patch_calls(monkeypatch, FailingCall(nth, number))
        with pytest.raises(FileWriteError, match=r"cannot be written: .*\n.*try again") as caught:
            write_atomic(path, NEW, keep_old=True)
        restore_calls(monkeypatch)
        assert path.read_text() == (NEW if caught.value.changed else OLD)
        assert ("No existing file was changed" in caught.value.hint) is not caught.value.changed
        assert {p.name for p in path.parent.iterdir()} <= {"so101.toml", "so101.toml.bak"}
        write_atomic(path, OLD)


@pytest.mark.campaign
@pytest.mark.timeout(1200)
def test_10000_random_power_cuts_leave_no_partial_file(path, monkeypatch):
    chance = random.Random(6)
    calls = calls_of_a_save(path, monkeypatch)
    for _ in range(10_000):
        PowerSupply(chance.randrange(calls)).limit_files(monkeypatch)
        with pytest.raises(PowerCut):
            write_atomic(path, NEW, keep_old=True)
        restore_calls(monkeypatch)
        assert path.read_text() in (OLD, NEW)
        write_atomic(path, OLD)


def test_removing_a_missing_file_is_not_an_error(tmp_path):
    remove_durably(tmp_path / "nothing")


def test_durable_file_removal_deletes_file(path):
    remove_durably(path)
    assert not path.exists()


def test_writability_check_refuses_folder_below_a_file(tmp_path):
    (tmp_path / "no_folder").write_text("")
    with pytest.raises(FileWriteError):
        check_writable(tmp_path / "no_folder" / "arms")


def test_writability_check_leaves_no_file(tmp_path):
    check_writable(tmp_path / "arms")
    assert not list((tmp_path / "arms").iterdir())


def test_writing_several_files_creates_their_folders(tmp_path):
    files = {tmp_path / "a" / "b": b"1", tmp_path / "c" / "d" / "e": b"2"}
    write_all_atomic(files)
    assert all(path.read_bytes() == data for path, data in files.items())
    assert len([path for path in tmp_path.rglob("*") if path.is_file()]) == 2


def test_failed_write_of_several_files_keeps_old_files(tmp_path):
    old = tmp_path / "old"
    old.write_text(OLD)
    with pytest.raises(FileWriteError, match="old/new"):
        write_all_atomic({old: b"new", old / "new": b"new"})
    assert (old.read_text(), [each.name for each in tmp_path.iterdir()]) == (OLD, ["old"])
