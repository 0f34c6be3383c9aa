"""Answers in the dialogue of a calibration: from the keyboard, or from a script."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Generic, Protocol, TypeVar

from ikservo.cli.terminal import Keys, read_keys
from ikservo.errors import CalibrationError, InputError

__all__ = ["AnswerSource", "KeyAnswers", "answers_from", "apply_or_explain"]

State = TypeVar("State")
State_contra = TypeVar("State_contra", contravariant=True)


class AnswerSource(Protocol[State_contra]):
    """Source of answers: the user, a script, or automatic acceptance."""

    def next_answer(self, state: State_contra, at_s: float) -> str | None:
        """Return the next answer, or None if there is none yet."""
        ...


class KeyAnswers(Generic[State]):
    """Answers from the keyboard; the display lists the keys.

    Args:
        keys: Returns the keys pressed since it was last called.
        answer_for_key: Returns the answer that a key stands for in a state, or None.
    """

    def __init__(self, keys: Keys, answer_for_key: Callable[[State, str], str | None]) -> None:
        self._keys, self._answer_for_key = keys, answer_for_key

    def next_answer(self, state: State, at_s: float) -> str | None:
        """Return the answer for the first key pressed since the last reading."""
        return self._answer_for_key(state, self._keys()[:1].lower())


@contextmanager
def answers_from(
    script: AnswerSource[State] | None,
    answer_for_key: Callable[[State, str], str | None],
    *,
    interactive: bool,
) -> Generator[AnswerSource[State]]:
    """Yield the source of answers: the script, or the keyboard where there is none.

    Raises:
        InputError: There is no script, and no user; names the options to use instead.
    """
    if script is not None:
        yield script
    elif interactive and sys.stdin.isatty():
        with read_keys() as keys:
            yield KeyAnswers(keys, answer_for_key)
    else:
        raise InputError(
            "Cannot ask: input is not a terminal.", "Give --yes, or --from-script FILE."
        )


def apply_or_explain(
    apply: Callable[[], State],
    state: State,
    source: AnswerSource[State],
    explain: Callable[[str], None],
) -> State:
    """Return the state after an answer; where a typed one is not possible now, say why.

    Raises:
        CalibrationError: An answer of a script is not possible now.
    """
    try:
        return apply()
    except CalibrationError as error:
        if not isinstance(source, KeyAnswers):
            raise
        explain(f"{error.message} {error.command_hint}")
        return state
