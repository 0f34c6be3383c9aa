"""Write and read binary STL, the format of meshes for drawing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ikservo.errors import FileFormatError

_HEAD_BYTES = 84
_MAX_BYTES = 2 * 1024 * 1024
_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def stl_bytes(triangles: NDArray[np.float64]) -> bytes:
    """Return triangles (n, 3, 3) as the content of a binary STL."""
    rows = np.zeros(len(triangles), dtype=_ROW)
    rows["corners"] = triangles
    a, b, c = triangles.transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    rows["normal"] = normals / np.where(lengths > 0.0, lengths, 1.0)
    count = np.array([len(triangles)], dtype="<u4")
    return b"ikservo, metres".ljust(80) + count.tobytes() + rows.tobytes()


def read_stl(path: Path) -> NDArray[np.float64]:
    """Read the triangles (n, 3, 3) of a binary STL that was made for drawing.

    Raises:
        FileFormatError: The file is missing, not an STL, or too large.
    """
    expected = "a binary STL, as `ikservo arms new` writes it"
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise FileFormatError(path, "", f"cannot be read ({error.strerror})", expected) from error
    count = int.from_bytes(data[_HEAD_BYTES - 4 : _HEAD_BYTES], "little")
    if len(data) > _MAX_BYTES or len(data) != _HEAD_BYTES + count * _ROW.itemsize:
        raise FileFormatError(path, "", "is not a small binary STL", expected)
    corners = np.frombuffer(data, _ROW, offset=_HEAD_BYTES)["corners"].astype(np.float64)
    if not len(corners) or not np.isfinite(corners).all():
        raise FileFormatError(path, "", "has no triangles", expected)
    return corners
