"""One controller at a time; the others watch."""

from __future__ import annotations

__all__ = ["Lease"]


class Lease:
    """Who may move the arm.

    Attributes:
        holder: The number of the visitor in control, None while nobody is.
    """

    def __init__(self) -> None:
        self.holder: int | None = None

    def take(self, visitor: int) -> None:
        """Give control to a visitor, whoever had it before."""
        self.holder = visitor

    def give(self, visitor: int) -> bool:
        """Take control back from a visitor; return whether it had it."""
        held = self.holder == visitor
        if held:
            self.holder = None
        return held
