"""Screen and world: pixels, cameras, the ray through a pixel (lecture L14, L15)."""
