"""Replies of a served arm as JSON, for both the control socket and the network.

A reply has a ``result`` (see ``result_json``) or an ``error``: its class, message, hint, exit code
and details, from which the other end recreates the error.

``ikservo stop`` imports this module, so it must not import NumPy, pydantic or pyserial.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from typing import Any, cast

from ikservo.errors import ExitCode, IkservoError

SAME_VERSION = "Install the same version of this program at both ends."

_MAX_CHARS = 4096


def error_fields(error: BaseException) -> dict[str, Any]:
    """Return an error as JSON values; errors from other libraries become a general failure.

    Message and hint are in terms of the command line; details are the other attributes with plain
    values.
    """
    if not isinstance(error, IkservoError):
        what = f"{type(error).__name__}: {error}".removesuffix(": ")
        error = IkservoError(f"The request failed in the other program: {what}")
    details: dict[str, object] = {}
    for name, value in vars(error).items():
        if not _is_detail(type(error), name):
            continue
        try:
            plain = {"bytes": value.hex()} if isinstance(value, bytes) else value
            text = json.dumps(plain, allow_nan=False)
        except (TypeError, ValueError):  # such as a path
            text = json.dumps(str(value))
        if len(text) <= _MAX_CHARS:
            details[name] = json.loads(text)
    return {
        "kind": type(error).__name__,
        "message": error.command_message[:_MAX_CHARS],
        "hint": error.command_hint[:_MAX_CHARS],
        "exit_code": int(error.exit_code),
        "details": details,
    }


def error_of(fields: Mapping[str, Any]) -> IkservoError:
    """Return the error that ``error_fields`` described; ``IkservoError`` for unknown classes."""
    match fields:
        case {"kind": str(name), "message": str(message), "hint": str(hint),
              "exit_code": int(code), "details": {}}:  # fmt: skip
            kind = _error_types().get(name, IkservoError)
        case _:
            return other_version_error()
    details = cast("dict[str, object]", fields["details"])
    error = kind.__new__(kind)  # __init__ would build the message from unknown parts
    IkservoError.__init__(error, message, hint)
    try:
        for detail, value in details.items():
            if _is_detail(kind, detail):
                setattr(error, detail, _from_json(value))
        str(error)
    except (TypeError, ValueError, AttributeError):  # another version, or somebody hostile
        return other_version_error()
    if code in list(ExitCode):
        error.exit_code = ExitCode(code)
    return error


def _from_json(value: object) -> object:
    match value:
        case list():
            return tuple(cast("list[object]", value))
        case {"bytes": str(digits)}:
            return bytes.fromhex(digits)
        case _:
            return value


def result_in(reply: Mapping[str, Any]) -> object:
    """Return the result in a reply as JSON values.

    Raises:
        IkservoError: The reply contains an error, or is invalid.
    """
    match reply:
        case {"error": {**fields}}:
            raise error_of(fields)
        case {"result": result}:
            return result
        case _:
            raise other_version_error()


def other_version_error() -> IkservoError:
    """Return the error for a reply with unexpected fields."""
    hint = f"It may be another version of ikservo. {SAME_VERSION}"
    return IkservoError("The program that has the arm open sent an unexpected reply.", hint)


def _is_detail(kind: type[IkservoError], name: str) -> bool:
    """Check whether an attribute belongs to an error instance rather than to its class."""
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
