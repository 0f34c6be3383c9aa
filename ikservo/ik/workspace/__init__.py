"""Which points the tip can reach: cut by a plane or as a volume, on a grid of equal cells."""

from ikservo.ik.workspace.filling import Clear, workspace
from ikservo.ik.workspace.grid import Grid
from ikservo.ik.workspace.planes import front_plane, side_plane, top_plane
from ikservo.ik.workspace.region import Workspace
from ikservo.ik.workspace.samples import joint_samples

__all__ = [
    "Clear",
    "Grid",
    "Workspace",
    "front_plane",
    "joint_samples",
    "side_plane",
    "top_plane",
    "workspace",
]
