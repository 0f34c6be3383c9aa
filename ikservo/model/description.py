"""A description of an arm's geometry, whatever its format: URDF, xacro or MJCF."""

from __future__ import annotations

from pathlib import Path

from ikservo.model.mjcf import read_mjcf
from ikservo.model.urdf import Urdf, read_urdf

__all__ = ["read_description"]

_HEAD_BYTES = 64 * 1024


def read_description(path: Path, folder: Path | None = None) -> Urdf:
    """Read a description; an ``.xml`` whose outermost element is <mujoco> is an MJCF.

    Args:
        path: The file.
        folder: Under which its meshes may lie; its own if None.

    Raises:
        FileFormatError: It cannot be used; says where and why.
        InputError: What reads its format is not installed.
    """
    return read_mjcf(path, folder) if _is_mjcf(path) else read_urdf(path, folder)


def _is_mjcf(path: Path) -> bool:
    if path.suffix != ".xml":
        return False
    try:
        with path.open("rb") as file:
            return b"<mujoco" in file.read(_HEAD_BYTES)
    except OSError:
        return False  # the reader of URDFs says why
