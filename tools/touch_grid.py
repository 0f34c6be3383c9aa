"""Draw the sheet of crosses for touch-offs: ``python tools/touch_grid.py > docs/touch-grid.svg``.

One unit of the drawing is a millimetre of an A4 sheet in front of the arm, with its long edge
across; the lower edge is nearest to the arm.
"""

from __future__ import annotations

from collections.abc import Iterator

from ikservo.apps.calibrating.touch_procedure import HIGH_M, WIDE_M, grid_points

WIDE, HIGH = round(1000 * WIDE_M), round(1000 * HIGH_M)
ARM = 5  # from the middle of a cross to its ends
BAR = 100  # what the scale bar must measure

LINE = 'stroke="black" stroke-width="0.2"'
TEXT = 'font-family="sans-serif" font-size="4"'


def drawing() -> str:
    """Return the whole drawing."""
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDE}mm" height="{HIGH}mm" '
        f'viewBox="0 0 {WIDE} {HIGH}">',
        f'<rect width="{WIDE}" height="{HIGH}" fill="white"/>',
        *_crosses(),
        *_scale_bar(),
        *_arrow(),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _crosses() -> Iterator[str]:
    for name, out_m, left_m in grid_points():
        x, y = WIDE / 2 - 1000 * left_m, HIGH - 1000 * out_m
        yield f'<path d="M{x - ARM:g} {y:g}h{2 * ARM}M{x:g} {y - ARM:g}v{2 * ARM}" {LINE}/>'
        yield f'<circle cx="{x:g}" cy="{y:g}" r="1.5" fill="none" {LINE}/>'
        yield f'<text x="{x + 2:g}" y="{y - 2:g}" {TEXT}>{name}</text>'


def _scale_bar() -> Iterator[str]:
    x, y = 12, HIGH - 10
    yield f'<path d="M{x} {y - 2}v4M{x} {y}h{BAR}m0 -2v4" fill="none" {LINE}/>'
    yield f'<text x="{x + 2}" y="{y - 2}" {TEXT}>{BAR} mm: print at 100 %, then measure</text>'


def _arrow() -> Iterator[str]:
    x = WIDE / 2
    yield f'<path d="M{x:g} {HIGH}v-20m-3 6l3 -6l3 6" fill="none" {LINE}/>'
    yield f'<text x="{x + 5:g}" y="{HIGH - 5}" {TEXT}>away from the arm; the arm stands here</text>'


if __name__ == "__main__":
    print(drawing(), end="")
