"""Who holds a device open, as far as the system tells."""

from __future__ import annotations

from pathlib import Path

__all__ = ["holder_of"]

_PROCESSES = Path("/proc")  # Linux only; elsewhere nobody is named


def holder_of(device: str) -> str:
    """Return ``command (process 123)`` of a process that has the device open, or empty."""
    wanted = Path(device).resolve()
    for process in _PROCESSES.glob("[0-9]*"):
        if _has_open(process, wanted):
            return f"{_command(process)} (process {process.name})"
    return ""


def _has_open(process: Path, device: Path) -> bool:
    try:
        return any(link.readlink() == device for link in (process / "fd").iterdir())
    except OSError:  # another user's process, or it has just ended
        return False


def _command(process: Path) -> str:
    try:
        words = (process / "cmdline").read_bytes().split(b"\0")
    except OSError:
        return "a program"
    return b" ".join(words).decode(errors="replace").strip()[:80]
