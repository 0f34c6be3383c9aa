"""Recompute every ``<inertial>`` of the shipped arms from their masses and simple shapes.

``python tools/inertias.py`` reports links whose numbers differ and exits with 1;
``python tools/inertias.py --write`` corrects them in place.

The mass of a link is given in its file. A shape whose name ends in a servo model weighs what
the datasheet gives; the other shapes divide the remaining mass in proportion to their
volume. Each shape is solid and of uniform density.
"""

from __future__ import annotations

import math
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

# Mass of one servo [kg]: ROBOTIS e-manual; Feetech's STS3215 sheet.
# fmt: off
SERVO_KG = {
    "STS3215":    0.055,
    "XL330-M288": 0.018,
    "XL330-M077": 0.018,
    "XL430-W250": 0.057,
    "XM430-W350": 0.082,
    "XM540-W270": 0.165,
}
# fmt: on

ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # entries of the tensor, in URDF's order


@dataclass(frozen=True, slots=True)
class Solid:
    """One solid shape in the frame of its link; lengths in m, inertia per kg in m²."""

    servo_kg: float | None
    centre_m: Matrix
    R_link_solid: Matrix
    volume_m3: float
    inertia_per_kg: Matrix

    def about(self, point_m: Matrix, mass_kg: float) -> Matrix:
        """Return the (3, 3) inertia about a point of the link, in link axes [kg·m²]."""
        own = self.R_link_solid @ self.inertia_per_kg @ self.R_link_solid.T
        d = self.centre_m - point_m
        return mass_kg * (own + (d @ d) * np.eye(3) - np.outer(d, d))


def main(argv: Sequence[str]) -> int:
    """Check all arms, or write the computed values."""
    differing = [path for path in sorted(CONFIGS.glob("*/arm.urdf")) if is_stale(path)]
    for path in differing:
        print(f"{path.parent.name}: inertials differ from what the shapes give")
        if "--write" in argv:
            path.write_text(rewritten(path.read_text()))
    return 1 if differing and "--write" not in argv else 0


def is_stale(path: Path) -> bool:
    """Return whether a file's inertials are not those of its shapes."""
    text = path.read_text()
    return rewritten(text) != text


def rewritten(urdf: str) -> str:
    """Return the text of a URDF with every ``<inertial>`` recomputed."""
    for link in ET.fromstring(urdf).iter("link"):
        if link.find("inertial") is not None:
            urdf = _with_inertial(urdf, link.attrib["name"], inertial_lines(link))
    return urdf


def _with_inertial(urdf: str, link_name: str, lines: str) -> str:
    block = re.compile(
        rf'(<link name="{re.escape(link_name)}">\s*<inertial>\n).*?(\n *</inertial>)', re.DOTALL
    )
    return block.sub(lambda match: match[1] + lines + match[2], urdf, count=1)


def inertial_lines(link: ET.Element) -> str:
    """Return the three lines inside ``<inertial>``: centre of mass, mass, inertia."""
    mass_kg, centre_m, inertia = mass_properties(link)
    tensor = " ".join(f'i{"xyz"[i]}{"xyz"[j]}="{_number(inertia[i, j], 10)}"' for i, j in ENTRIES)
    xyz = " ".join(_number(value, 6) for value in centre_m)
    return (
        f'      <origin xyz="{xyz}" rpy="0 0 0"/>\n'
        f'      <mass value="{mass_kg:g}"/>\n'
        f"      <inertia {tensor}/>"
    )


def mass_properties(link: ET.Element) -> tuple[float, Matrix, Matrix]:
    """Return mass [kg], centre of mass (3,) [m] and inertia (3, 3) about it [kg·m²]."""
    mass_kg = float(_child(link, "inertial/mass").attrib["value"])
    solids = [_solid(collision) for collision in link.iter("collision")]
    weighed = list(zip(_shares(mass_kg, solids), solids, strict=True))
    centre_m, inertia = np.zeros(3), np.zeros((3, 3))
    for share_kg, solid in weighed:
        centre_m += share_kg / mass_kg * solid.centre_m
    for share_kg, solid in weighed:
        inertia += solid.about(centre_m, share_kg)
    return mass_kg, centre_m, inertia


def _shares(mass_kg: float, solids: Sequence[Solid]) -> list[float]:
    rest_kg = mass_kg - sum(solid.servo_kg or 0.0 for solid in solids)
    rest_m3 = sum(solid.volume_m3 for solid in solids if solid.servo_kg is None)
    if rest_kg <= 0.0 or rest_m3 <= 0.0:
        raise ValueError(f"nothing is left of {mass_kg} kg beside the servos")
    return [s.servo_kg or rest_kg * s.volume_m3 / rest_m3 for s in solids]


def _solid(collision: ET.Element) -> Solid:
    origin = _child(collision, "origin").attrib
    volume_m3, inertia_per_kg = _volume_and_inertia(_child(collision, "geometry")[0])
    return Solid(
        servo_kg=SERVO_KG.get(collision.attrib["name"].split()[-1]),
        centre_m=_numbers(origin["xyz"]),
        R_link_solid=_rotation(*_numbers(origin["rpy"])),
        volume_m3=volume_m3,
        inertia_per_kg=inertia_per_kg,
    )


def _child(element: ET.Element, path: str) -> ET.Element:
    child = element.find(path)
    if child is None:
        raise ValueError(f"<{element.tag} name={element.get('name')!r}> has no {path}")
    return child


def _volume_and_inertia(shape: ET.Element) -> tuple[float, Matrix]:
    if shape.tag == "box":
        x, y, z = _numbers(shape.attrib["size"])
        return x * y * z, np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) / 12.0
    r = float(shape.attrib["radius"])
    if shape.tag == "sphere":
        return 4.0 / 3.0 * math.pi * r**3, np.eye(3) * 0.4 * r * r
    h = float(shape.attrib["length"])
    across = (3.0 * r * r + h * h) / 12.0
    return math.pi * r * r * h, np.diag([across, across, r * r / 2.0])


def _rotation(roll: float, pitch: float, yaw: float) -> Matrix:
    c, s = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    R_x = np.array([[1, 0, 0], [0, c[0], -s[0]], [0, s[0], c[0]]])
    R_y = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
    R_z = np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]])
    return R_z @ R_y @ R_x


def _numbers(text: str) -> Matrix:
    return np.array([float(word) for word in text.split()])


def _number(value: float, decimals: int) -> str:
    return f"{round(value, decimals) + 0.0:.{decimals}f}".rstrip("0").rstrip(".")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
