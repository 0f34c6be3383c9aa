"""Answers that did not come: one is bridged, a series stops the arm."""

from __future__ import annotations

from collections.abc import Container, Sequence

from ikservo.errors import ServoSilentError

__all__ = ["Losses"]


class Losses:
    """Counts the cycles in a row in which a joint's servo did not answer.

    Args:
        names: The joints.
        most: The series that stops the arm.
    """

    def __init__(self, names: Sequence[str], most: int = 3) -> None:
        self._row = dict.fromkeys(names, 0)
        self._most = most

    @property
    def lost(self) -> tuple[str, ...]:
        """Return the joints whose last answer is missing."""
        return tuple(name for name, row in self._row.items() if row)

    def see(self, answered: Container[str]) -> None:
        """Note which joints answered in this cycle.

        Raises:
            ServoSilentError: A joint was silent too many times in a row; names all such.
        """
        for name in self._row:
            self._row[name] = 0 if name in answered else self._row[name] + 1
        silent = [name for name, row in self._row.items() if row >= self._most]
        if silent:
            raise ServoSilentError(
                f"did not answer {self._most} times in a row", servo=", ".join(silent)
            )
