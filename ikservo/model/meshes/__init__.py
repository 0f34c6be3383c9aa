"""Meshes of a description become capsules that contain them."""

from __future__ import annotations

from ikservo.model.meshes.covering import capsules_around_mesh, capsules_around_surface

__all__ = ["capsules_around_mesh", "capsules_around_surface"]
