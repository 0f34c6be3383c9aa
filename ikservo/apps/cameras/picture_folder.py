"""A folder with pictures of a board and the joint positions in each picture, for an estimate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from pydantic import Field

from ikservo.apps.cameras.board_detection import Picture
from ikservo.calibration.calibration_file import dump_calibration, read_calibration
from ikservo.calibration.records import Calibration, Name, Text
from ikservo.errors import FileFormatError, InputError
from ikservo.files.reading import MAX_BYTES, parse_toml, read_text
from ikservo.files.validation import StrictModel
from ikservo.files.writing import checked_toml, strip_checksum, write_atomic
from ikservo.kinematics.arrays import Vector

_INDEX, _CALIBRATION = "pictures.toml", "calibration.toml"
_HEADER = "# Pictures of a board on the gripper, and the joints of the arm; written by ikservo.\n"
_MAX_PICTURE_BYTES = 100_000_000


class SavedPicture(StrictModel):
    """An entry of ``[[pictures]]``: a picture and its measured joint positions."""

    file: Annotated[str, Field(pattern=r"^picture-[0-9]{3}\.png$")] = Field(
        description="picture-001.png …"
    )
    joints_rad: tuple[float, ...] = Field(
        strict=False, description="a number for each joint, rad or m"
    )


class PictureIndex(StrictModel):
    """The content of the index file."""

    format: Literal[1] = Field(default=1, description="1")
    arm: Name = Field(description="an arm's name")
    source: Text = Field(description="the camera: a number, device or address")
    camera_name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{0,64}$")] = Field(
        description="the camera's name, or nothing"
    )
    board: Text = Field(description="COLUMNSxROWS-SQUAREmm-FAMILY")
    by_hand: bool = Field(description="true or false")
    joints: tuple[Name, ...] = Field(strict=False, description="the joints' names")
    pictures: tuple[SavedPicture, ...] = Field(
        default=(), strict=False, max_length=1000, description="tables [[pictures]]"
    )


class PictureFolder:
    """New folder in which each picture is saved when it is taken, so that a failure loses none.

    Args:
        path: The folder.
        index: The description of the pictures that will follow.
        calibration: The calibration with which the joints are measured; None for a simulated arm.

    Raises:
        InputError: The folder is not empty.
        FileWriteError: The folder cannot be written.
    """

    def __init__(self, path: Path, index: PictureIndex, calibration: Calibration | None) -> None:
        self.require_new(path)
        self._path, self._index = path, index
        if calibration is not None:
            write_atomic(path / _CALIBRATION, dump_calibration(calibration))
        self._write_index()

    @staticmethod
    def require_new(path: Path) -> None:
        """Refuse a folder that is not empty.

        Raises:
            InputError: The folder is not empty, or it is a file.
        """
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise InputError(f"{path} exists and is not empty.", "Name a new folder.")

    def add(self, picture: Picture, q: Vector) -> None:
        """Save a picture and the joints (dof,), rad or m.

        Raises:
            FileWriteError: The disk is full or not writable; the pictures so far are kept.
        """
        import cv2  # noqa: PLC0415  # from the extra `camera`

        before = self._index.pictures
        file = f"picture-{len(before) + 1:03}.png"
        write_atomic(self._path / file, cv2.imencode(".png", picture)[1].tobytes())
        saved = SavedPicture(file=file, joints_rad=tuple(q.tolist()))
        self._index = self._index.model_copy(update={"pictures": (*before, saved)})
        self._write_index()

    def _write_index(self) -> None:
        text = checked_toml(_HEADER, self._index.model_dump(mode="python"))
        write_atomic(self._path / _INDEX, text)


@dataclass(frozen=True, slots=True)
class SavedPictures:
    """The content of a folder of pictures; pictures of a simulated arm have no calibration."""

    folder: Path
    index: PictureIndex
    calibration: Calibration | None

    def pictures(self) -> Iterator[tuple[Picture, Vector]]:
        """Yield each picture with its joints (dof,), rad or m.

        Raises:
            FileFormatError: A picture is missing, too large or damaged.
        """
        import cv2  # noqa: PLC0415  # from the extra `camera`

        for saved in self.index.pictures:
            path = self.folder / saved.file
            is_small = path.is_file() and path.stat().st_size <= _MAX_PICTURE_BYTES
            read = cast("Any", cv2)  # missing from the type stubs
            picture = read.imread(str(path), read.IMREAD_UNCHANGED) if is_small else None
            if picture is None:
                raise FileFormatError(path, "", "is missing or damaged", "a saved picture")
            yield np.asarray(picture, dtype=np.uint8), np.array(saved.joints_rad)


def read_pictures(folder: Path, arm: str, joints: Sequence[str]) -> SavedPictures:
    """Read a folder of pictures of an arm with given joints.

    Raises:
        FileFormatError: The folder has no pictures, they show another arm, or a file is damaged.
    """
    path = folder / _INDEX
    tables = parse_toml(path, strip_checksum(path, read_text(path, MAX_BYTES)))
    index = PictureIndex.from_tables(tables, path)
    if index.arm != arm:
        raise FileFormatError(path, "arm", f"is {index.arm}", arm)
    if index.joints != tuple(joints):
        raise FileFormatError(path, "joints", "differ from those of the arm", ", ".join(joints))
    if any(len(saved.joints_rad) != len(joints) for saved in index.pictures):
        found = "a picture has too few or too many joint positions"
        raise FileFormatError(path, "pictures", found, f"{len(joints)} per picture")
    path = folder / _CALIBRATION
    calibration = read_calibration(path) if path.exists() else None
    if calibration is not None and calibration.arm != arm:
        raise FileFormatError(path, "arm", f"is {calibration.arm}", arm)
    return SavedPictures(folder, index, calibration)
