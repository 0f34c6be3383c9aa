"""Arms of any number of links in a plane."""

import math
from pathlib import Path

from ikservo.model import Model
from ikservo.model.model_loading import build_chain
from ikservo.model.urdf_types import Cylinder, Urdf, UrdfJoint, UrdfJointType, UrdfLink


def planar_model(lengths_m, limit_rad=math.pi):
    """Return an arm in the plane z = 0 with a turning joint before each link.

    Args:
        lengths_m: The links, base to tip, metres.
        limit_rad: Limit of each joint to either side.
    """
    names = ["base", *(f"link{i + 1}" for i in range(len(lengths_m))), "tool"]
    before = [0.0, *lengths_m]
    joints = [
        _make_planar_joint(f"joint{i + 1}", names[i], names[i + 1], before[i], limit_rad)
        for i in range(len(lengths_m))
    ]
    joints.append(_make_planar_joint("tip", names[-2], names[-1], before[-1], None))
    radius_m = 0.06 * max(lengths_m)
    links = [
        _make_bar_link(name, length, radius_m)
        for name, length in zip(names[1:], lengths_m, strict=False)
    ]
    ends = [
        _make_bar_link("base", 0.0, 1.6 * radius_m),
        *links,
        _make_bar_link("tool", None, radius_m),
    ]
    urdf = Urdf("planar", tuple(ends), tuple(joints), "base")
    title = f"{len(lengths_m)} links in a plane"
    return Model.from_geometry(
        "planar", title, build_chain(urdf, "tool"), urdf, Path("planar.urdf")
    )


def _make_planar_joint(name, parent, child, x_m, limit_rad):
    kind = UrdfJointType.FIXED if limit_rad is None else UrdfJointType.REVOLUTE
    limit = limit_rad or 0.0
    return UrdfJoint(
        name, kind, parent, child, (x_m, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0),
        -limit, limit, math.inf, math.inf, None, 1,
    )  # fmt: skip


def _make_bar_link(name, length_m, radius_m):
    """Return a link that is a bar along x; a link without length has no body."""
    body = () if length_m is None else (
        Cylinder(radius_m, length_m, (0.5 * length_m, 0.0, 0.0), (0.0, math.pi / 2, 0.0)),
    )  # fmt: skip
    none = (0.0, 0.0, 0.0)
    return UrdfLink(name, 0.0, none, none, (*none, *none), body, body, 1)
