"""What can go wrong around the simulated bus; servos themselves answer with error numbers."""

from __future__ import annotations

from pathlib import Path

__all__ = ["ArmFileError", "FaultError", "PortClosedError", "SimulatorError", "UnknownModelError"]


class SimulatorError(Exception):
    """Anything that keeps a simulated bus from being set up."""


class ArmFileError(SimulatorError, ValueError):
    """An arm file that cannot be used: where in it, what was found, what was expected."""

    def __init__(self, path: Path, where: str, found: str) -> None:
        self.path, self.where, self.found = path, where, found
        super().__init__(f"{path}, {where}: {found}" if where else f"{path}: {found}")


class FaultError(SimulatorError, ValueError):
    """A fault that cannot be: unknown kind, key or value."""


class UnknownModelError(SimulatorError, LookupError):
    """A servo model without a datasheet table."""

    def __init__(self, model: str, known: tuple[str, ...]) -> None:
        self.model, self.known = model, known
        super().__init__(f"no datasheet table for {model!r}; known: {', '.join(known)}")


class PortClosedError(OSError):
    """The port was closed or its cable pulled; the text is the one pyserial uses."""

    def __init__(self, message: str = "device disconnected") -> None:
        super().__init__(message)
