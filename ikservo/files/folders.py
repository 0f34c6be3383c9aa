"""The folder of a person's own files."""

from __future__ import annotations

import os
from pathlib import Path


def config_dir() -> Path:
    """Return the folder of the user's own files: ``IKSERVO_HOME``, or the system's default."""
    own = os.environ.get("IKSERVO_HOME")
    if own:
        return Path(own)
    from platformdirs import user_config_path  # noqa: PLC0415  # only where it is needed

    return user_config_path("ikservo", appauthor=False)
