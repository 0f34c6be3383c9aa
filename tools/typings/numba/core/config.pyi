"""Settings of numba, read from the environment when it is imported."""

CACHE_DIR: str
DISABLE_JIT: bool
