"""Draw how each arm is wired.

``python tools/wiring_drawings.py`` writes docs/pictures/wiring-*.svg.

Servos, ids and joints are those of the arm files, so a drawing cannot contradict them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from pathlib import Path

import ikservo

__all__ = ["WIRINGS", "Wiring", "draw"]

_FOLDER = Path(__file__).parents[1] / "docs" / "pictures"
_BOX, _GAP, _TOP = (118, 62), 26, 150
_DATA, _POWER, _USB = "#1565c0", "#c62828", "#555555"


@dataclass(frozen=True, slots=True)
class Wiring:
    """The parts between the computer and the servos of an arm.

    Attributes:
        arm: The name of the arm.
        adapter: Two lines of text.
        supply: Two lines of text.
        converter: The joint before which a converter lowers the voltage, and two lines of text.
    """

    arm: str
    adapter: tuple[str, str]
    supply: tuple[str, str]
    converter: tuple[str, str, str] | None = None


WIRINGS = (
    Wiring("so101", ("serial bus servo board", "jumpers on B (USB)"),
           ("power supply: see the label", "7.4 V or 12 V servos?")),
    Wiring("koch", ("serial bus servo board", "or U2D2 with hub"), ("12 V supply", "for the XL430"),
           ("elbow_flex", "converter", "12 V to 5 V")),
    Wiring("open_manipulator_x", ("U2D2 and power hub", "3-pin plug (TTL)"),
           ("12 V, 5 A", "into the hub")),
)  # fmt: skip


def draw(wiring: Wiring) -> str:
    """Return the drawing as SVG: computer and adapter above, the chain of servos below."""
    joints = ikservo.load_model(wiring.arm).joints
    width = _GAP + len(joints) * (_BOX[0] + _GAP)
    parts = [
        *_box(_GAP, 20, ("computer", "USB"), _USB),
        *_box(_GAP + 190, 20, wiring.adapter, _DATA, 190),
        *_box(_GAP + 450, 20, wiring.supply, _POWER, 200),
        _line([(_GAP + _BOX[0], 51), (_GAP + 190, 51)], _USB),
        _line([(_GAP + 450, 51), (_GAP + 380, 51)], _POWER),
        _line([(_GAP + 285, 82), (_GAP + 285, 115), (_GAP + 59, 115), (_GAP + 59, _TOP)], _DATA),
    ]
    for place, joint in enumerate(joints):
        x = _GAP + place * (_BOX[0] + _GAP)
        parts += _servo(x, joint.name, joint.servo.model, joint.servo.id, first=place == 0)
        if wiring.converter and joint.name == wiring.converter[0]:
            parts += _converter(x - _GAP // 2, wiring.converter[1:])
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} 330" width="{width}" '
        f'height="330" font-family="sans-serif" font-size="13">\n'
        f"<title>Wiring of {escape(wiring.arm)}</title>\n{body}\n{_legend()}\n</svg>\n"
    )


def _servo(x: int, joint: str, model: str, servo_id: int, *, first: bool) -> Iterator[str]:
    """Yield a servo with its joint, and the cable from the previous servo."""
    if not first:
        yield _line([(x - _GAP, _TOP + 31), (x, _TOP + 31)], _DATA)
    yield from _box(x, _TOP, (f"id {servo_id}", model), _DATA)
    yield f'<text x="{x + _BOX[0] / 2}" y="{_TOP + 82}" text-anchor="middle">{escape(joint)}</text>'


def _converter(x: int, words: tuple[str, str]) -> Iterator[str]:
    yield from _box(x - 59, _TOP + 96, words, _POWER, 118, 40)
    yield _line([(x, _TOP + 96), (x, _TOP + 31)], _POWER)


def _box(
    x: int, y: int, words: tuple[str, str], colour: str, width: int = _BOX[0], height: int = _BOX[1]
) -> Iterator[str]:
    yield (
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="6" fill="white" '
        f'stroke="{colour}" stroke-width="2"/>'
    )
    for line, text in enumerate(words):
        at = y + height / 2 - 4 + 18 * line
        yield f'<text x="{x + width / 2}" y="{at:g}" text-anchor="middle">{escape(text)}</text>'


def _line(points: list[tuple[int, int]], colour: str) -> str:
    text = " ".join(f"{x},{y}" for x, y in points)
    return f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-width="3"/>'


def _legend() -> str:
    entries = (
        (_USB, "USB cable"),
        (_DATA, "servo cable: ground, supply, data"),
        (_POWER, "supply"),
    )
    parts: list[str] = []
    for place, (colour, text) in enumerate(entries):
        x = _GAP + 300 * place - (120 if place else 0)
        parts.append(_line([(x, 318), (x + 30, 318)], colour))
        parts.append(f'<text x="{x + 38}" y="322">{text}</text>')
    return "\n".join(parts)


if __name__ == "__main__":
    for each in WIRINGS:
        (_FOLDER / f"wiring-{each.arm}.svg").write_text(draw(each), "utf-8")
