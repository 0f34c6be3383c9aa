"""A planar arm that turns little, so that a search for its stops is short."""

import re

from tests.oracle import CONFIGS


def write_narrow_arm(folder):
    """Write the file of an arm whose two joints turn 25° to both sides; return its path."""
    text = (CONFIGS / "planar2" / "arm.toml").read_text()
    text = re.sub(r"joint([12]) = -?[\d.]+", r"joint\1 = 5.0", text)
    (folder / "arm.toml").write_text(text.replace('name   = "planar2"', 'name = "narrow"'))
    urdf = (CONFIGS / "planar2" / "arm.urdf").read_text()
    urdf = re.sub(r'lower="[^"]*"', 'lower="-0.436"', urdf)
    (folder / "arm.urdf").write_text(re.sub(r'upper="[^"]*"', 'upper="0.436"', urdf))
    return str(folder / "arm.toml")
