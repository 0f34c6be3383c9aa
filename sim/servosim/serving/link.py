"""A name that stays for a port whose own name changes."""

from __future__ import annotations

from pathlib import Path

from servosim.errors import SimulatorError

__all__ = ["point_link", "remove_link"]


def point_link(link: Path, port: Path) -> None:
    """Make a symbolic link to a port; an older link gives way, anything else does not.

    Raises:
        SimulatorError: Something else has that name.
    """
    if link.is_symlink():
        link.unlink()
    elif link.exists():
        raise SimulatorError(f"{link} is there already and is no link; choose another name")
    link.symlink_to(port)


def remove_link(link: Path, port: Path) -> None:
    """Remove the link, unless somebody else has pointed it to another port."""
    if link.is_symlink() and link.readlink() == port:
        link.unlink()
