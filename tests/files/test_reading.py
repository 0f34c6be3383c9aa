"""A path that is not a readable text file is refused with the reason."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from ikservo.errors import FileFormatError
from ikservo.files.reading import read_text


def refusal(path: Path) -> str:
    with pytest.raises(FileFormatError) as caught:
        read_text(path, 1024)
    assert caught.value.where == ""
    return caught.value.found


def test_reading_missing_file_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / "nowhere.urdf") == "does not exist"


def test_path_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a")
    assert refusal(tmp_path / "a" / "b") == "cannot be read (Not a directory)"


def test_folder_is_refused_as_a_file(tmp_path: Path) -> None:
    assert refusal(tmp_path) == "is a folder"


def test_pipe_is_refused_as_a_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert refusal(tmp_path / "pipe") == "is not a regular file"


def test_device_is_refused_as_a_file() -> None:
    assert refusal(Path("/dev/zero")) == "is not a regular file"


def test_file_name_that_is_too_long_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / ("a" * 5000)) == "cannot be read (File name too long)"


def test_path_with_a_null_byte_is_refused() -> None:
    assert refusal(Path("a\0b")) == "is not a valid path"


def test_file_without_read_permission_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text("<robot/>")

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    assert refusal(path) == "cannot be read (Permission denied)"


def test_circular_symlink_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("a")
    assert refusal(tmp_path / "a") == "cannot be read (Too many levels of symbolic links)"


def test_file_one_byte_above_the_limit_is_refused(tmp_path: Path) -> None:
    (tmp_path / "big").write_text("a" * 1025)
    assert refusal(tmp_path / "big") == "is too large"


def test_file_of_exactly_the_limit_is_read(tmp_path: Path) -> None:
    (tmp_path / "full").write_text("a" * 1024)
    assert len(read_text(tmp_path / "full", 1024)) == 1024
