"""The joints after a motion: they are corrected by what they measure until they are at rest."""
