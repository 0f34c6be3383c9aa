"""Ticks become radians: one servo's place in one joint, its seam, its limits."""
