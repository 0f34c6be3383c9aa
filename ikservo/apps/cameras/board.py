"""The printed board for cameras, with squares and markers (ChArUco)."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ikservo.errors import BadValueError, InputError, shown
from ikservo.kinematics.arrays import Matrix
from ikservo.remedies import install_command

if TYPE_CHECKING:
    from cv2.aruco import CharucoBoard

_NAME = re.compile(r"(\d{1,2})x(\d{1,2})-(\d{1,3}(?:\.\d)?)mm-([4-7]x[4-7])")
_EXPECTED = "COLUMNSxROWS-SQUAREmm-FAMILY, such as 5x7-12mm-4x4"
_MARKER_SHARE = 0.75  # side of a marker, as a fraction of the side of a square
_RULER_MM, _MARGIN_MM = 50, 10
_PT_PER_MM = 72.0 / 25.4
_FAMILY_SIZE = 100  # number of markers in a family


def require_opencv() -> None:
    """Raise if OpenCV is not installed.

    Raises:
        InputError: OpenCV is not installed.
    """
    if importlib.util.find_spec("cv2") is None:
        hint = f"Install it: {install_command('camera')}"
        raise InputError("Cameras need OpenCV, which is not installed.", hint)


@dataclass(frozen=True, slots=True)
class Board:
    """A board of black and white squares with a marker in each white square.

    Attributes:
        columns: Number of squares in a row.
        rows: Number of rows.
        square_m: The side of a square, metres.
        family: The size of the markers: ``4x4``, ``5x5``, ``6x6`` or ``7x7`` bits.
    """

    columns: int
    rows: int
    square_m: float
    family: str

    @classmethod
    def named(cls, name: str) -> Board:
        """Return the board for a name such as ``5x7-12mm-4x4``.

        Raises:
            BadValueError: The text is not the name of a board, or the board cannot be made.
        """
        match = _NAME.fullmatch(name)
        columns, rows = (int(match[1]), int(match[2])) if match else (0, 0)
        bits = match[4].split("x") if match else ["", "-"]
        if not (match and min(columns, rows) >= 3 and bits[0] == bits[1] and float(match[3])):
            raise BadValueError("The board", shown(name), _EXPECTED)
        if columns * rows > 2 * _FAMILY_SIZE:
            raise BadValueError("The board", shown(name), f"at most {2 * _FAMILY_SIZE} squares")
        return cls(columns, rows, float(match[3]) / 1000.0, match[4])

    @property
    def name(self) -> str:
        """Name of the board."""
        return f"{self.columns}x{self.rows}-{1000 * self.square_m:g}mm-{self.family}"

    def corners_m(self) -> Matrix:
        """Return the inner corners (k, 3), metres, in the order of their numbers.

        The origin is in the middle of the board, x to the right, y down, like the axes of a picture
        in OpenCV.
        """
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        flat = np.stack([x.ravel() - self.columns / 2, y.ravel() - self.rows / 2, 0.0 * x.ravel()])
        return np.asarray(self.square_m * flat.T, dtype=np.float64)

    def opencv(self) -> CharucoBoard:
        """Return the board as an OpenCV object.

        Raises:
            InputError: OpenCV is not installed.
        """
        require_opencv()
        import cv2  # noqa: PLC0415  # from the extra `camera`

        family = getattr(cv2.aruco, f"DICT_{self.family.upper()}_{_FAMILY_SIZE}")
        markers = cv2.aruco.getPredefinedDictionary(family)
        return cv2.aruco.CharucoBoard(
            (self.columns, self.rows), self.square_m, _MARKER_SHARE * self.square_m, markers
        )

    def svg(self) -> str:
        """Return a page with the board and a ruler as SVG.

        Raises:
            InputError: OpenCV is not installed.
        """
        width, height = self._page_mm()
        x, y = _MARGIN_MM, height - _MARGIN_MM
        text = 'font-family="sans-serif" font-size="3"'
        return "\n".join([
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
            f'viewBox="0 0 {width:g} {height:g}">',
            f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
            *(f'<rect x="{a:g}" y="{b:g}" width="{w:g}" height="{h:g}"/>'
              for a, b, w, h in self._black_mm()),
            f'<path d="M{x} {y - 2}v4M{x} {y}h{_RULER_MM}m0 -2v4" fill="none" stroke="black" '
            'stroke-width="0.2"/>',
            f'<text x="{x}" y="{y - 3}" {text}>{self._caption()}</text>',
            "</svg>", "",
        ])  # fmt: skip

    def pdf(self) -> bytes:
        """Return the page with the board and a ruler as PDF.

        Raises:
            InputError: OpenCV is not installed.
        """
        width, height = self._page_mm()
        x, y = _MARGIN_MM, _MARGIN_MM
        drawn = [
            f"{a:.4f} {height - b - h:.4f} {w:.4f} {h:.4f} re" for a, b, w, h in self._black_mm()
        ]
        content = "\n".join([
            f"{_PT_PER_MM:.6f} 0 0 {_PT_PER_MM:.6f} 0 0 cm", *drawn, "f", "0.2 w",
            f"{x} {y} m {x + _RULER_MM} {y} l {x} {y - 2} m {x} {y + 2} l "
            f"{x + _RULER_MM} {y - 2} m {x + _RULER_MM} {y + 2} l S",
            f"BT /F 3 Tf {x} {y + 3} Td ({self._caption()}) Tj ET",
        ])  # fmt: skip
        size = f"{width * _PT_PER_MM:.3f} {height * _PT_PER_MM:.3f}"
        return _pdf([
            "<< /Type /Catalog /Pages 2 0 R >>",
            "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {size}] /Contents 4 0 R "
            "/Resources << /Font << /F << /Type /Font /Subtype /Type1 /BaseFont /Helvetica >> >> "
            ">> >>",
            f"<< /Length {len(content)} >>\nstream\n{content}\nendstream",
        ])  # fmt: skip

    def _caption(self) -> str:
        return f"ikservo {self.name}: print at 100 %; this line is {_RULER_MM} mm long"

    def _page_mm(self) -> tuple[float, float]:
        square = 1000.0 * self.square_m
        width = max(self.columns * square, _RULER_MM + 25) + 2 * _MARGIN_MM
        return width, self.rows * square + 4 * _MARGIN_MM

    def _black_mm(self) -> Iterator[tuple[float, float, float, float]]:
        """Yield the black rectangles: left, top, width and height on the page."""
        board, square = self.opencv(), 1000.0 * self.square_m
        marker, markers = _MARKER_SHARE * square, iter(board.getIds().ravel().tolist())
        cells = int(self.family[0]) + 2  # the marker has a black frame, one bit wide
        bit = marker / cells
        for row in range(self.rows):
            for column in range(self.columns):
                x, y = _MARGIN_MM + column * square, _MARGIN_MM + row * square
                if (row + column) % 2 == 0:
                    yield x, y, square, square
                    continue
                picture = board.getDictionary().generateImageMarker(next(markers), 8 * cells)
                black = picture[4::8, 4::8] < 128
                left, top = x + (square - marker) / 2, y + (square - marker) / 2
                for i, j in np.argwhere(black).tolist():
                    yield left + j * bit, top + i * bit, bit, bit


def _pdf(objects: list[str]) -> bytes:
    """Return a PDF file that contains the given objects, the catalogue first."""
    parts, starts = ["%PDF-1.4\n"], list[int]()
    for number, body in enumerate(objects, start=1):
        starts.append(sum(map(len, parts)))
        parts.append(f"{number} 0 obj\n{body}\nendobj\n")
    table = "".join(f"{start:010d} 00000 n \n" for start in starts)
    count, at = len(objects) + 1, sum(map(len, parts))
    parts.append(f"xref\n0 {count}\n0000000000 65535 f \n{table}")
    parts.append(f"trailer\n<< /Size {count} /Root 1 0 R >>\nstartxref\n{at}\n%%EOF\n")
    return "".join(parts).encode("ascii")
