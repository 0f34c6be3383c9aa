"""The tools that write pages and drawings, as imports."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "tools"))

from pages import GENERATED, generated_pages  # noqa: F401
from wiring_drawings import WIRINGS, draw  # noqa: F401
