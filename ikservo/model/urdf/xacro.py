"""Expanding the macros of a xacro file by the program or the Python package of that name."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

from ikservo.errors import FileFormatError

__all__ = ["expanded"]

_PATIENCE_S = 30.0
_RUN = "import sys, xacro; sys.argv = ['xacro', sys.argv[1]]; xacro.main()"


def expanded(path: Path) -> str:
    """Return the URDF that a xacro file stands for.

    xacro evaluates expressions of the file: only one that is trusted is to be given.

    Raises:
        FileFormatError: xacro is not installed, or does not accept the file; says why.
    """
    command = _command(path)
    try:
        done = subprocess.run(  # noqa: S603  # a program of the person's own, one file name
            command, capture_output=True, text=True, timeout=_PATIENCE_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FileFormatError(path, "", f"xacro failed ({error})", "a xacro file") from error
    if done.returncode != 0:
        why = " ".join(done.stderr.split())[:200] or f"exit code {done.returncode}"
        raise FileFormatError(path, "", f"xacro refuses it: {why}", "a xacro file without errors")
    return done.stdout


def _command(path: Path) -> list[str]:
    """Return what to run: the package of this Python first, else the program."""
    program = shutil.which("xacro")
    if importlib.util.find_spec("xacro") is not None:
        return [sys.executable, "-c", _RUN, str(path.absolute())]
    if program is not None:
        return [program, str(path.absolute())]
    raise FileFormatError(
        path, "", "its macros need xacro, which is not installed",
        "xacro (pip install xacro), or plain URDF",
    )  # fmt: skip
