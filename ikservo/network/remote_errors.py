"""Errors as JSON and back: the same class, message, hint, exit code and details."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import cache

from pydantic import BaseModel, ConfigDict, JsonValue

from ikservo.errors import ExitCode, IkservoError

__all__ = ["SAME_VERSION", "ErrorFields", "error_from_fields", "fields_of_error"]

SAME_VERSION = "Install the same version of this program at both ends."

_MAX_CHARS = 4096


class ErrorFields(BaseModel):
    """An error of the other end.

    Attributes:
        kind: The name of its class.
        message: What happened, in terms of the command line.
        hint: What to do now, in terms of the command line.
        exit_code: Of the command line.
        details: Its other attributes, as far as they are plain values.
    """

    model_config = ConfigDict(extra="forbid")
    kind: str
    message: str
    hint: str = ""
    exit_code: int = 1
    details: dict[str, JsonValue] = {}


def fields_of_error(error: BaseException) -> ErrorFields:
    """Return an error as a message; one that is not of ikservo as a failure."""
    if not isinstance(error, IkservoError):
        text = f"It failed there: {type(error).__name__}: {error}".removesuffix(": ")
        return ErrorFields(kind="IkservoError", message=text[:_MAX_CHARS])
    return ErrorFields(
        kind=type(error).__name__,
        message=error.command_message[:_MAX_CHARS],
        hint=error.command_hint[:_MAX_CHARS],
        exit_code=int(error.exit_code),
        details=dict(_details_of(error)),
    )


def error_from_fields(fields: ErrorFields) -> IkservoError:
    """Return the error of a message; one of an unknown class is an ``IkservoError``."""
    kind = _error_types().get(fields.kind, IkservoError)
    error = kind.__new__(kind)  # its own __init__ builds the message from parts that it has not
    IkservoError.__init__(error, fields.message, fields.hint)
    for name, value in fields.details.items():
        if _is_detail(kind, name):
            setattr(error, name, tuple(value) if isinstance(value, list) else value)
    if fields.exit_code in list(ExitCode):
        error.exit_code = ExitCode(fields.exit_code)
    return error


def _details_of(error: IkservoError) -> Iterator[tuple[str, JsonValue]]:
    for name, value in vars(error).items():
        if _is_detail(type(error), name):
            try:
                yield name, json.loads(json.dumps(value, allow_nan=False))
            except (TypeError, ValueError):  # bytes of a packet, a path
                yield name, str(value)


def _is_detail(kind: type[IkservoError], name: str) -> bool:
    """Check whether an attribute belongs to the errors of one class and hides nothing of it."""
    shared = ("command_message", "command_hint", "exit_code", "args")
    return name.isidentifier() and name[0] != "_" and name not in shared and not hasattr(kind, name)


@cache
def _error_types() -> Mapping[str, type[IkservoError]]:
    from ikservo.files import writing as _  # noqa: F401, PLC0415  # has an error of its own

    found: dict[str, type[IkservoError]] = {}
    pending: list[type[IkservoError]] = [IkservoError]
    while pending:
        kind = pending.pop()
        if kind.__module__.startswith("ikservo."):
            found[kind.__name__] = kind
        pending += kind.__subclasses__()
    return found
