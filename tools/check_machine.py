"""Report before an installation what this machine lacks; pip reports it only after minutes.

ruckig (0.12.2 to 0.19.4) has no wheel for Linux on ARM, as on a Raspberry Pi, so pip compiles it.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
import sysconfig
from pathlib import Path

__all__ = ["missing_text"]


def missing_text(machine: str, compiler: str | None, headers: Path) -> str:
    """Return what is missing and how to install it; empty if nothing is.

    Args:
        machine: System and processor, as in ``Linux aarch64``.
        compiler: The C++ compiler; None if there is none.
        headers: The folder in which Python's headers should be.
    """
    system, processor = machine.split(maxsplit=1)
    compiles = system == "Linux" and processor.startswith(("aarch64", "arm"))
    if not compiles or (compiler and (headers / "Python.h").exists()):
        return ""
    return (
        "ruckig has no wheel for Linux on ARM, so pip compiles it. That needs a C++ compiler and "
        "Python's headers.\nInstall them: sudo apt install g++ python3-dev"
    )


if __name__ == "__main__":
    sys.exit(
        missing_text(
            f"{platform.system()} {platform.machine()}",
            shutil.which(os.environ.get("CXX", "c++")),
            Path(sysconfig.get_path("include")),
        )
        or 0
    )
