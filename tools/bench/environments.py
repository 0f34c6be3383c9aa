"""One virtual environment per peer, made when it is first needed and kept for the next run."""

from __future__ import annotations

import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path

__all__ = ["PEERS", "Peer", "UnavailableError", "interpreter_for"]

ROOT = Path(__file__).parents[2]
SHELF = ROOT / "build" / "bench-venvs"
_INSTALL_TIMEOUT_S = 900


@dataclass(frozen=True)
class Peer:
    """A solver to measure.

    Attributes:
        name: Its name in the table.
        runner: Its file in ``peers/``.
        requirements: Packages that pip installs for it; none for ours, which runs in this Python.
    """

    name: str
    runner: str
    requirements: tuple[str, ...] = ()


# fmt: off
PEERS = (
    Peer("ikservo",         "run_ikservo.py"),
    Peer("roboticstoolbox", "run_roboticstoolbox.py", ("roboticstoolbox-python",)),
    Peer("pinocchio",       "run_pinocchio.py",       ("pin",)),
    Peer("ikpy",            "run_ikpy.py",            ("ikpy",)),
    Peer("mink",            "run_mink.py",            ("mink", "daqp")),
    Peer("placo",           "run_placo.py",           ("placo",)),
    Peer("eaik",            "run_eaik.py",            ("EAIK",)),
    Peer("ssik",            "run_ssik.py",            ("ssik[urdf]",)),
    Peer("optik",           "run_optik.py",           ("optik-py", "numpy")),
    Peer("scipy",           "run_scipy.py",           ("scipy",)),
)
# fmt: on


class UnavailableError(Exception):
    """A peer cannot be installed here; the message is pip's last line."""


def interpreter_for(peer: Peer) -> Path:
    """Return the Python that has the peer; install the peer first if that is necessary.

    Raises:
        UnavailableError: pip cannot install it.
    """
    if not peer.requirements:
        return Path(sys.executable)
    folder = SHELF / peer.name
    done = folder / "installed"
    if not done.is_file() or done.read_text() != "\n".join(peer.requirements):
        _install(peer, folder)
        done.write_text("\n".join(peer.requirements))
    return _python_in(folder)


def _install(peer: Peer, folder: Path) -> None:
    print(f"installing {peer.name} …", file=sys.stderr, flush=True)
    venv.create(folder, clear=True, with_pip=True)
    pip = [str(_python_in(folder)), "-m", "pip", "install", "--disable-pip-version-check", "-q"]
    try:
        subprocess.run(
            [*pip, *peer.requirements],
            capture_output=True,
            text=True,
            check=True,
            timeout=_INSTALL_TIMEOUT_S,
        )
    except subprocess.TimeoutExpired:
        raise UnavailableError(f"pip took longer than {_INSTALL_TIMEOUT_S} s") from None
    except subprocess.CalledProcessError as failure:
        raise UnavailableError(_last_line(failure.stderr)) from None


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip()[:160] if lines else "pip failed without a message"


def _python_in(folder: Path) -> Path:
    return folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
