"""Run ``solve_all`` as Python without NumPy, which PyPy runs in a tenth of CPython's time.

    pypy3 tools/kernel/run_without_numpy.py FOLDER < arguments > results

FOLDER holds the package; its kernels are read as they are. Arguments are a line of JSON with the
shape of each array, then their numbers as doubles, row by row. Results are a line with what
``solve_all`` returned, then the numbers of the same arrays. Needs Python 3.9 or newer.
"""

from __future__ import annotations

import ast
import importlib
import json
import math
import sys
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType

__all__ = ["Matrix", "Vector", "load_solve_all"]

_PACKAGES = ("ikservo", "ikservo.ik", "ikservo.kernels", "ikservo.kinematics")
_PACKED = "ikservo.kinematics.packed"


class Vector:
    """A view of some doubles in a row, with checked indices."""

    def __init__(self, items: array[float], first: int, size: int) -> None:
        self._items, self._first, self._size = items, first, size

    def __len__(self) -> int:
        """Return the number of items."""
        return self._size

    def __getitem__(self, key: int | slice) -> float | Vector:
        """Return an item, or a view of the last ones for ``[first:]``."""
        if isinstance(key, slice):
            if key.stop is not None or key.step is not None or not 0 <= key.start <= self._size:
                raise IndexError(key)
            return Vector(self._items, self._first + key.start, self._size - key.start)
        return self._items[self._place(key)]

    def __setitem__(self, key: int, value: float) -> None:
        """Set an item."""
        self._items[self._place(key)] = value

    def _place(self, i: int) -> int:
        if not 0 <= i < self._size:
            raise IndexError(i)
        return self._first + i


class Matrix:
    """Doubles row by row, with checked indices."""

    def __init__(self, items: array[float], rows: int, width: int) -> None:
        self._items, self.shape = items, (rows, width)
        self._rows, self._width = rows, width

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._rows

    def __getitem__(self, key: int | tuple[int, int]) -> float | Vector:
        """Return an item, or a view of a row."""
        if isinstance(key, tuple):
            return self._items[self._place(*key)]
        return Vector(self._items, self._place(key, 0), self._width)

    def __setitem__(self, key: tuple[int, int], value: float) -> None:
        """Set an item."""
        self._items[self._place(*key)] = value

    def _place(self, i: int, j: int) -> int:
        if not (0 <= i < self._rows and 0 <= j < self._width):
            raise IndexError((i, j))
        return i * self._width + j


def load_solve_all(folder: Path) -> Callable[..., int]:
    """Import the kernels from the package in a folder, and nothing else of it."""
    for name in _PACKAGES:
        _put_module(name, __path__=[str(folder.joinpath(*name.split(".")))])
    _put_module("ikservo.kernels.compiled", entry=_entry, vectorised=_unchanged)
    _put_module("ikservo.kinematics.arrays", Matrix=Matrix, Vector=Vector)
    _put_module(_PACKED, **_constants(folder.joinpath(*_PACKED.split(".")).with_suffix(".py")))
    return importlib.import_module("ikservo.kernels.search").solve_all


def _put_module(name: str, **contents: object) -> None:
    module = sys.modules[name] = ModuleType(name)
    vars(module).update(contents)


def _entry(_: Callable[..., bool]) -> Callable[[Callable[..., object]], Callable[..., object]]:
    return _unchanged


def _unchanged(function: Callable[..., object]) -> Callable[..., object]:
    return function


def _constants(path: Path) -> dict[str, object]:
    """Return the constants that a module assigns; the rest of it needs NumPy."""
    tree = ast.parse(path.read_text("utf-8"))
    tree.body = [each for each in tree.body if isinstance(each, ast.Assign)]
    found: dict[str, object] = {"math": math}
    exec(compile(tree, str(path), "exec"), found)
    return found


def _array(shape: Sequence[int], data: memoryview) -> tuple[Matrix | Vector, array[float]]:
    items = array("d")
    items.frombytes(data)
    if len(shape) == 1:
        return Vector(items, 0, shape[0]), items
    return Matrix(items, *shape), items


def main() -> None:
    """Read the arguments, run the kernel and write the results."""
    if sys.implementation.name == "pypy":
        # By default PyPy does not compile functions as long as some here, which takes twice the
        # time.
        importlib.import_module("pypyjit").set_param("trace_limit=16000")
    shapes: list[list[int]] = json.loads(sys.stdin.buffer.readline())
    data, first = memoryview(sys.stdin.buffer.read()), 0
    arguments: list[Matrix | Vector] = []
    contents: list[array[float]] = []
    for shape in shapes:
        end = first + 8 * math.prod(shape)
        argument, items = _array(shape, data[first:end])
        arguments.append(argument)
        contents.append(items)
        first = end
    returned = load_solve_all(Path(sys.argv[1]))(*arguments)
    sys.stdout.buffer.write(json.dumps(returned).encode() + b"\n")
    for items in contents:
        sys.stdout.buffer.write(items.tobytes())


if __name__ == "__main__":
    main()
