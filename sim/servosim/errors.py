"""Errors about the simulated bus; servos themselves reply with error numbers."""

from __future__ import annotations

from pathlib import Path


class SimulatorError(ValueError):
    """Base class of errors about input that cannot be used to set up a simulated bus."""


class ArmFileError(SimulatorError):
    """An error in an arm file: its place, and what was found there."""

    def __init__(self, path: Path, where: str, found: str) -> None:
        self.path, self.where, self.found = path, where, found
        super().__init__(f"{path}, {where}: {found}" if where else f"{path}: {found}")


class FaultError(SimulatorError):
    """An invalid fault: unknown kind, key or value."""


class LogFileError(SimulatorError):
    """A log or an audit that cannot be written."""

    def __init__(self, path: Path, error: OSError) -> None:
        self.path = path
        super().__init__(f"{path} cannot be written: {error.strerror or error}.")


class UnknownModelError(SimulatorError, LookupError):
    """A servo model without a datasheet table."""

    def __init__(self, model: str, known: tuple[str, ...]) -> None:
        self.model, self.known = model, known
        super().__init__(f"no datasheet table for {model!r}; known: {', '.join(known)}")


class PortClosedError(OSError):
    """The port was closed or unplugged; the text is that of pyserial."""

    def __init__(self, message: str = "device disconnected") -> None:
        super().__init__(message)
