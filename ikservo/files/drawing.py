"""Drawings: strokes of a pen from CSV and SVG files, scaled and placed in the arm's base frame."""

from __future__ import annotations

import io
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from ikservo.errors import BadValueError, FileFormatError, InputError, shown
from ikservo.files.reading import parse_path, quote, read_text
from ikservo.remedies import install_command

if TYPE_CHECKING:
    from svgelements import PathSegment

Matrix = NDArray[np.float64]

_MAX_BYTES = 4 * 1024 * 1024
_MAX_POINTS = 20_000
# Every three tokens (a command and two numbers) give at least one point, so this limit follows from
# the number of points. Tokens are counted before an SVG is read, once per use.
_MAX_NUMBERS, _MAX_ELEMENTS, _MAX_DEPTH = 3 * _MAX_POINTS + 100, 10_000, 64
_MAX_CSS_CHARS = 40_000_000  # characters of style sheets, which are read again for each element
_MAX_INHERITED = 2_000_000
_NUMBERS = ("d", "points", "transform", "gradientTransform", "viewBox")
_DIGITS = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z]")
_UNITS_M = {"m": 1.0, "mm": 0.001}
_HEADER = re.compile(r"[xyz](_(?P<unit>mm|m))?", re.IGNORECASE)
# An SVG pixel is 1/96 inch (CSS); millimetres in a file are converted with the same factor.
_PIXELS_PER_INCH, _PIXEL_M = 96.0, 0.0254 / 96.0
_POINTS_PER_CURVE = 64
# Points nearer than this to the line between their neighbours do not change the drawn line.
_TOLERANCE_M = 5e-5


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """Strokes of a pen.

    Attributes:
        strokes_m: Points (k, 3) of each stroke, metres: x forward and y left, as in the base frame.
        ignored: The parts of the file that are not drawn.
    """

    strokes_m: tuple[Matrix, ...]
    ignored: tuple[str, ...] = ()

    @property
    def size_m(self) -> tuple[float, float]:
        """Extent along x and along y, metres."""
        points = np.concatenate(self.strokes_m)
        along_x, along_y = np.ptp(points[:, :2], axis=0).tolist()
        return along_x, along_y

    def scaled(self, factor: float) -> Drawing:
        """Return the drawing scaled about its origin.

        Raises:
            BadValueError: The factor is not positive.
        """
        if not 0.0 < factor < math.inf:
            raise BadValueError("The scale of the drawing", f"{factor:g}", "a number above 0")
        return replace(self, strokes_m=tuple(factor * stroke for stroke in self.strokes_m))

    def with_width(self, width_m: float) -> Drawing:
        """Return the drawing, scaled about its origin so that its longer side has the given length.

        Raises:
            BadValueError: The width is not positive, or the drawing has no extent.
        """
        largest = max(self.size_m)
        if not largest > 0.0:
            raise BadValueError("The drawing", "a single point", "a drawing with an extent")
        return self.scaled(width_m / largest)

    def placed(self, origin_m: Sequence[float], angle_rad: float = 0.0) -> Drawing:
        """Return the drawing rotated about the vertical, with its origin at a point (3,) [m]."""
        cos, sin = math.cos(angle_rad), math.sin(angle_rad)
        R = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        origin = np.asarray(origin_m, dtype=np.float64)
        return replace(self, strokes_m=tuple(s @ R.T + origin for s in self.strokes_m))

    def simplified(self) -> Drawing:
        """Return the drawing without points that change it by less than 0.05 mm."""
        strokes = tuple(_simplify(stroke, _TOLERANCE_M) for stroke in self.strokes_m)
        return replace(self, strokes_m=strokes)


def read_drawing(path: Path | str, unit: str | None = None) -> Drawing:
    """Read strokes from a file: SVG if its name ends in ``.svg``, otherwise CSV.

    A CSV has a point x, y or x, y, z in each line, and an empty line between two strokes. Its
    numbers are metres, unless its header (``x_mm,y_mm``) or ``unit`` says millimetres.

    An SVG is drawn at its own size (its ``width`` and ``height``; a pixel is 1/96 inch), as seen
    from behind the arm: its right is the arm's right, its top is away from the arm. Its lower left
    corner becomes the origin. Needs the extra ``draw``.

    Args:
        path: The file.
        unit: ``m`` or ``mm``, for a CSV without a unit in its header.

    Raises:
        FileFormatError: The file is missing, empty, too large or malformed; the line is named.
        InputError: svgelements is not installed.
        InputError: The unit is neither m nor mm, or contradicts the file.
    """
    file = parse_path(path)
    if unit is not None and (not isinstance(cast("object", unit), str) or unit not in _UNITS_M):
        raise BadValueError("The unit", quote(shown(unit, str)), "m or mm")
    text = read_text(file, _MAX_BYTES)
    if file.suffix.lower() == ".svg":
        if unit is not None:
            raise InputError("An SVG has its own unit.", "Leave out the unit, or give a scale.")
        drawing = _read_svg(file, text)
    else:
        drawing = Drawing(tuple(_read_csv(file, text, unit)))
    if sum(len(stroke) for stroke in drawing.strokes_m) > _MAX_POINTS:
        raise _too_many_points(file)
    return drawing


def _too_many_points(path: Path) -> FileFormatError:
    return FileFormatError(path, "", f"has more than {_MAX_POINTS} points")


def _read_csv(path: Path, text: str, unit: str | None) -> Iterator[Matrix]:
    lines = [line.strip() for line in text.splitlines()]
    first = next(i for i, line in enumerate(lines) if line)
    columns_named = [_HEADER.fullmatch(name.strip()) for name in lines[first].split(",")]
    named = ""
    if all(columns_named):  # the first line is a header
        units = {(match["unit"] or "").lower() for match in columns_named if match}
        if len(units) > 1:
            raise FileFormatError(path, "line 1", "mixes units", "one unit for all columns")
        named = units.pop()
        lines[first] = ""
    if named and unit and named != unit:
        found = f"{unit}, and {named} in the header of {path}"
        raise BadValueError("The unit", found, "the same unit in both places")
    factor = _UNITS_M[unit or named or "m"]
    stroke: list[list[float]] = []
    columns = count = 0
    for number, line in enumerate([*lines, ""], start=1):
        if count > _MAX_POINTS:
            raise _too_many_points(path)
        if line and not line.startswith("#"):
            stroke.append(_parse_row(path, number, line, columns))
            count += 1
            columns = len(stroke[-1])
        elif stroke and not line:
            yield factor * _with_height(np.array(stroke))
            stroke = []
    if not columns:
        raise FileFormatError(path, "", "has no points", "a point x, y or x, y, z in each line")


def _parse_row(path: Path, number: int, line: str, columns: int) -> list[float]:
    expected = f"{columns} numbers" if columns else "x, y or x, y, z"
    try:
        row = [float(word) for word in line.split(",")]
    except ValueError:
        raise FileFormatError(
            path, f"line {number}", f"{quote(line)} is not a list of numbers", expected
        ) from None
    if not all(math.isfinite(value) for value in row):
        raise FileFormatError(path, f"line {number}", f"{quote(line)} is not finite", expected)
    if len(row) not in ((columns,) if columns else (2, 3)):
        raise FileFormatError(path, f"line {number}", f"has {len(row)} numbers", expected)
    return row


def _with_height(points: Matrix) -> Matrix:
    """Return points (k, 3) from (k, 2) or (k, 3); points without height are in the plane."""
    if points.shape[1] == 3:
        return points
    return np.column_stack([points, np.zeros(len(points))])


def _read_svg(path: Path, text: str) -> Drawing:
    try:
        import svgelements  # noqa: PLC0415  # an extra
    except ImportError:
        raise InputError(
            "Reading SVG files needs svgelements, which is not installed.",
            f"CSV files do not need it. Install it: {install_command('draw')}",
        ) from None
    _check_svg(path, text)
    try:
        elements = list(svgelements.SVG.parse(io.StringIO(text), ppi=_PIXELS_PER_INCH).elements())
        shapes = [svgelements.Path(e) for e in elements if isinstance(e, svgelements.Shape)]
        if sum(_count_points(segment) for shape in shapes for segment in shape) > _MAX_POINTS:
            raise _too_many_points(path)
        subpaths = [svgelements.Path(part) for shape in shapes for part in shape.as_subpaths()]
        found = [_sample_segments(list(part)) for part in subpaths]
    except FileFormatError:
        raise
    except (ValueError, TypeError, ArithmeticError, LookupError, AttributeError) as error:
        raise FileFormatError(path, "", f"cannot be read as SVG ({error})", "SVG 1.1") from error
    strokes = [stroke for stroke in found if len(stroke) > 1]
    has_text = any(isinstance(e, svgelements.Text) for e in elements)
    ignored = ("text, which must be converted to paths first",) if has_text else ()
    if not strokes:
        expected = "paths; convert text to paths first" if has_text else "paths"
        raise FileFormatError(path, "", "has no lines to draw", expected)
    points = np.concatenate(strokes)
    if not np.isfinite(points).all():
        raise FileFormatError(path, "", "has points that are not finite")
    left, bottom = points[:, 0].min(), points[:, 1].max()
    placed = (np.column_stack([bottom - s[:, 1], left - s[:, 0]]) * _PIXEL_M for s in strokes)
    return Drawing(tuple(_with_height(stroke) for stroke in placed), ignored)


def _check_svg(path: Path, text: str) -> None:
    """Refuse an SVG that is not well-formed, has entities, or would become too large when read."""
    from defusedxml.common import DefusedXmlException  # noqa: PLC0415
    from defusedxml.ElementTree import fromstring  # noqa: PLC0415

    try:
        root = fromstring(text)
    except (ET.ParseError, DefusedXmlException, ValueError) as error:
        raise FileFormatError(path, "", f"is not XML ({error})", "an SVG file") from error
    if root.tag.rpartition("}")[2] != "svg":
        raise FileFormatError(
            path, "", f"is XML with root {quote(root.tag)}, not svg", "an SVG file"
        )
    elements, numbers, inherited = _SvgCost(path, root).of(root)
    sheets = sum(len(each.text or "") for each in root.iter() if each.tag.endswith("style"))
    for count, most, what in (
        (elements, _MAX_ELEMENTS, "elements, counted at each use"),
        (numbers, _MAX_NUMBERS, "numbers and commands in its paths"),
        (sheets * elements, _MAX_CSS_CHARS, "characters of style sheets to apply"),
        (inherited * elements, _MAX_INHERITED, "attributes that its elements inherit"),
    ):
        if count > most:
            found = f"has {count:,} {what}"
            raise FileFormatError(path, "", found, f"at most {most:,}; simplify the drawing")


class _SvgCost:
    """Count of an SVG's elements and numbers; elements that a <use> copies count once per use.

    svgelements copies inherited attributes and style declarations to each element.
    """

    def __init__(self, path: Path, root: ET.Element) -> None:
        self._path = path
        self._by_id = {name: each for each in root.iter() if (name := each.get("id"))}
        self._costs: dict[ET.Element, tuple[int, int, int]] = {}
        self._depth = 0

    def of(self, element: ET.Element) -> tuple[int, int, int]:
        """Count the elements, numbers and inheritable attributes inside an element.

        Raises:
            FileFormatError: A <use> contains itself, or elements are nested too deeply.
        """
        if element in self._costs:
            return self._costs[element]
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            found = "nests elements too deeply, or a <use> contains itself"
            raise FileFormatError(self._path, "", found, f"at most {_MAX_DEPTH} levels")
        used: list[ET.Element] = []
        if element.tag.rpartition("}")[2] == "use":
            names = [value for key, value in element.items() if key.rpartition("}")[2] == "href"]
            used = [self._by_id[n[1:]] for n in names if n[:1] == "#" and n[1:] in self._by_id]
        inside = [self.of(each) for each in (*element, *used)]
        own = sum(len(_DIGITS.findall(element.get(name, ""))) for name in _NUMBERS)
        attributes = len(element.attrib) + element.get("style", "").count(";")
        self._depth -= 1
        cost = (
            1 + sum(each[0] for each in inside),
            own + sum(each[1] for each in inside),
            attributes + max((each[2] for each in inside), default=0),
        )
        self._costs[element] = cost
        return cost


def _count_points(segment: PathSegment) -> int:
    from svgelements import Close, Line, Move  # noqa: PLC0415

    return 1 if isinstance(segment, Move | Line | Close) else _POINTS_PER_CURVE


def _sample_segments(segments: Sequence[PathSegment]) -> Matrix:
    """Sample the points (k, 2) [px] along a part of a path, drawn without lifting the pen."""
    points: list[tuple[float, float]] = []
    for segment in segments:
        count = _count_points(segment)
        at = [segment.point(i / count) for i in range(1, count + 1)] if segment.end else []
        points += [(point.x, point.y) for point in at]
    return np.array(points, dtype=np.float64).reshape(-1, 2)


def _simplify(points: Matrix, tolerance: float) -> Matrix:
    """Return the points (k, 3) that describe the line within a tolerance (Douglas and Peucker)."""
    keep = np.zeros(len(points), dtype=np.bool_)
    keep[[0, -1]] = True
    parts = [(0, len(points) - 1)]
    while parts:
        first, last = parts.pop()
        if last - first < 2:
            continue
        gone = points[first : last + 1] - points[first]
        along = gone[-1]
        length2 = float(along @ along)
        fractions = np.zeros(len(gone))
        if length2 > 0.0:
            fractions = np.clip(gone @ along / length2, 0.0, 1.0)
        # Distances from the straight line between the first and the last point.
        distances = np.linalg.norm(gone - np.outer(fractions, along), axis=1)
        worst = int(distances.argmax())
        if distances[worst] > tolerance:
            keep[first + worst] = True
            parts += [(first, first + worst), (first + worst, last)]
    return points[keep]
