"""Which points the tip can reach: cut by a plane or as a volume, on a grid of equal cells."""

from ikservo.ik.workspace.filling import workspace
from ikservo.ik.workspace.grid import Grid
from ikservo.ik.workspace.planes import front_plane, side_plane, top_plane
from ikservo.ik.workspace.region import Workspace

__all__ = ["Grid", "Workspace", "front_plane", "side_plane", "top_plane", "workspace"]
