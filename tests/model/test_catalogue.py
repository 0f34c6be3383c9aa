"""An arm's name leads to its file, and to no other file on the disk."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from ikservo.errors import UnknownNameError
from ikservo.model import catalogue
from ikservo.model.catalogue import arm_names, catalogue_name, find_arm


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "ikservo" / "_configs"
    for name in ("so101", "koch"):
        (folder / name).mkdir(parents=True)
        (folder / name / "arm.toml").write_text("format = 1")
    (tmp_path / "arm.toml").write_text("format = 1")
    monkeypatch.setattr(catalogue, "__file__", str(tmp_path / "ikservo/model/catalogue.py"))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    return folder


def test_arm_names_are_sorted(folder: Path) -> None:
    assert arm_names() == ["koch", "so101"]


def test_folder_without_arm_file_is_not_an_arm(folder: Path) -> None:
    (folder / "half").mkdir()
    assert "half" not in arm_names()


def test_folder_with_invalid_name_is_not_an_arm(folder: Path) -> None:
    (folder / "koch").rename(folder / "koch v1.1")
    assert arm_names() == ["so101"]


def test_missing_catalogue_folder_gives_no_arm_names(folder: Path) -> None:
    shutil.rmtree(folder)
    assert arm_names() == []


def test_arm_name_is_resolved_to_its_arm_file(folder: Path) -> None:
    assert find_arm("so101") == folder / "so101" / "arm.toml"


def test_misspelled_arm_name_error_suggests_closest_name(folder: Path) -> None:
    with pytest.raises(UnknownNameError) as caught:
        find_arm("so1O1")
    assert caught.value.hint == "Did you mean so101? Known: koch, so101."


@pytest.mark.parametrize("file", ["arm.toml", "mine.toml", "arm.urdf", "a.b.urdf"])
def test_path_to_arm_file_is_returned_unchanged(tmp_path: Path, file: str) -> None:
    (tmp_path / file).write_text("")
    assert find_arm(str(tmp_path / file)) == tmp_path / file


def test_arm_file_in_current_folder_does_not_need_separator(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder / "so101")
    assert find_arm("arm.toml") == Path("arm.toml")


def test_path_to_folder_is_resolved_to_its_arm_file(folder: Path) -> None:
    assert find_arm(f"{folder}/koch/") == folder / "koch" / "arm.toml"


def test_path_object_is_used_as_path_even_without_separator(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert find_arm(Path("koch")) == Path("koch/arm.toml")


def test_catalogue_name_of_arm_is_its_folder_name(folder: Path) -> None:
    assert catalogue_name(find_arm("koch")) == "koch"


def test_catalogue_name_is_found_for_relative_path(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder / "so101")
    assert catalogue_name(Path("arm.toml")) == "so101"


def test_arm_outside_catalogue_has_no_catalogue_name(tmp_path: Path) -> None:
    assert catalogue_name(tmp_path / "so101" / "arm.toml") is None


def test_installed_arms_have_priority_over_source_tree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = tmp_path / "ikservo" / "model" / "catalogue.py"
    (tmp_path / "ikservo" / "_configs" / "boxed").mkdir(parents=True)
    (tmp_path / "ikservo" / "_configs" / "boxed" / "arm.toml").write_text("")
    monkeypatch.setattr(catalogue, "__file__", str(module))
    assert arm_names() == ["boxed"]


# fmt: off
NO_PATHS = [
    "", " ", ".", "..", "...", "~", "-", "--arm", "*", "?", "so101 ", " so101", "so101\n",
    "so101\0", "so101\r", "so101\t", "SO101",
    "ѕо101", "so１０１", "so101.", "so101:", "so101;id", "so101|id",
    "$(id)", "`id`", "%2e%2e", "so101%00", "NUL", "CON", "C:arm", "ARM.TOML", "a" * 65,
    "a" * 100_000, "\ud800", "\u202eso101", "\x1b[31mso101", "..%2f..%2farm",
]
PATHS = [
    "../so101", "../../etc/passwd", "..\\so101", "....//so101", "./so101", "so101/", "so101/..",
    "/so101", "//so101", "so101/arm", "so101/arm.toml", "so101/../../arm.toml", "/etc/passwd",
    "/etc/passwd\0.toml", "../arm.toml\0", "/dev/zero", "/dev/stdin", "/proc/self/mem", "/",
    "/proc/self/environ", "\\\\server\\share\\arm.toml", "C:\\arm.toml", "file:///etc/passwd",
    "http://127.0.0.1/arm.toml", "package://so101/arm.toml", "a" * 300 + ".toml", "nowhere.toml",
    "a/" * 3000 + "arm.toml", "nowhere.urdf", "arm.toml/arm.toml", "%2e%2e%2fshelf/arm.toml",
    "..%2f..%2farm.toml", "\ud800.toml", "~/arm.toml", "~root/arm.toml", "so101.toml", ".toml",
]
# fmt: on


def refused(trick: str) -> None:
    """Look for an arm of that name, and expect none."""
    try:
        found = find_arm(trick)
    except UnknownNameError:
        return
    pytest.fail(f"{trick[:24]!a} has led to {found}")


def test_malicious_arm_name_does_not_open_a_file(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[object] = []
    with monkeypatch.context() as watched:
        for opener in ("builtins.open", "io.open", "os.open"):
            watched.setattr(opener, lambda *args, **_: opened.append(args))
        for trick in NO_PATHS + PATHS:
            refused(trick)
    assert opened == []


def test_invalid_arm_name_is_refused_without_disk_access(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked_at: list[str] = []
    real_stat = os.stat

    def watched(path: str | Path, **options: bool) -> os.stat_result:
        looked_at.append(os.fspath(path))
        return real_stat(path, **options)

    monkeypatch.setattr("os.stat", watched)
    for trick in NO_PATHS:
        refused(trick)
    known = {str(folder), str(folder / "so101" / "arm.toml"), str(folder / "koch" / "arm.toml")}
    assert set(looked_at) == known


def test_error_for_very_long_arm_name_is_short(folder: Path) -> None:
    with pytest.raises(UnknownNameError) as caught:
        find_arm("a" * 100_000)
    assert len(str(caught.value)) < 200
