"""MJCF, MuJoCo's descriptions, read by MuJoCo itself (extra ``physics``)."""

from __future__ import annotations

from ikservo.model.mjcf.reader import read_mjcf

__all__ = ["read_mjcf"]
