"""Format validation errors as one readable message that names the key."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, Self, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from ikservo.errors import FileFormatError
from ikservo.files.reading import quote

Location = tuple[int | str, ...]

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


class ValidationIssue(NamedTuple):
    """A validation issue with its location."""

    location: Location
    found: str
    expected: str


def first_issue(issues: Sequence[ValidationIssue], path: Path) -> FileFormatError:
    """Return the first issue as an error about the file, with the number of further issues."""
    first, more = issues[0], len(issues) - 1
    rest = f" (and {more} more to correct)" if more else ""
    return FileFormatError(
        path, format_key_path(first.location), first.found + rest, first.expected
    )


def first_mistake(error: ValidationError) -> tuple[str, str]:
    """Return the place of the first mistake (empty: the whole message), and the reason."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    return ".".join(map(str, first["loc"])), first["msg"]


def validation_issues(error: ValidationError, model: type[BaseModel]) -> list[ValidationIssue]:
    """Convert pydantic's errors; unknown keys come first, because they may explain missing keys."""
    details = error.errors(include_url=False, include_context=False)
    details.sort(key=lambda detail: detail["type"] != "extra_forbidden")
    issues = [_make_issue(detail, model) for detail in details]
    return list(dict.fromkeys(issues))  # a value fails once per allowed kind


# Names that pydantic adds to the location of a value that may be of several kinds.
_UNION_BRANCH = re.compile(
    r"(literal\[|constrained-|function-|lax-or-strict|json-or-python|tuple\[|list\[|dict\[|"
    r"(float|int|str|bool|none|is-instance)$)"
)


def _make_issue(detail: ErrorDetails, model: type[BaseModel]) -> ValidationIssue:
    full, kind = detail["loc"], detail["type"]
    # Leave out pydantic's names for the kinds of a union, such as "float".
    location = tuple(
        step
        for i, step in enumerate(full)
        if isinstance(step, int)
        or step == "[key]"
        or i == 0
        or not _UNION_BRANCH.match(step)
        or step in _resolve_location(full[:i], model)[0].model_fields
    )
    if kind == "extra_forbidden":
        known = list(_resolve_location(location[:-1], model)[0].model_fields)
        close = difflib.get_close_matches(str(location[-1]), known, n=1)
        listing = ", ".join(known)
        expected = f"{close[0]} (known here: {listing})" if close else f"one of {listing}"
        return ValidationIssue(location, "is not a known key", expected)
    message = detail["msg"].removeprefix("Value error, ").removesuffix(".")  # "." follows later
    if kind == "value_error" and message:  # concerns a whole table
        return ValidationIssue(location, message, "")
    expected = _resolve_location(location, model)[1]
    if location[-1] == "[key]":
        return ValidationIssue(
            location[:-2], f"has the key {_format_value(location[-2])}", expected
        )
    found = "is missing" if kind == "missing" else f"is {_format_value(detail['input'])}"
    return ValidationIssue(location, found, expected)


def _resolve_location(location: Location, model: type[BaseModel]) -> tuple[type[BaseModel], str]:
    """Return the innermost model at a location, and the description of its field."""
    expected, keys = "", iter(location)
    for key in keys:
        field = model.model_fields.get(str(key))
        if field is None:
            break
        expected = field.description or ""
        inner = _model_of_annotation(field.annotation)
        if inner is None:
            break
        model = inner
        if field.annotation is not inner:
            next(keys, None)  # the index in a list of tables, or the name of a table
    return model, expected


def _model_of_annotation(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model_of_annotation, get_args(annotation))), None)


def _format_value(value: object) -> str:
    """Format a value as TOML, shortened."""
    match value:
        case bool():
            return str(value).lower()
        case str():
            return quote(value)
        case int() if value.bit_length() > 64:
            return "a huge number"
        case Mapping():
            return "a table"
        case list():
            return "a list"
        case _:
            return str(value)


def format_key_path(location: Location) -> str:
    """Format a location as ``joints[2].servo.id``; quote keys that are not bare TOML keys."""
    steps: list[str] = []
    for key in location:
        if isinstance(key, int):
            steps.append(f"[{key}]")
        else:
            steps.append(f".{key if _BARE_KEY.fullmatch(key) and len(key) <= 64 else quote(key)}")
    return "".join(steps).removeprefix(".")


class StrictModel(BaseModel):
    """A table that is refused if a key is unknown or a value has the wrong type.

    Floats must be finite. Instances are immutable.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    @classmethod
    def from_tables(cls, tables: object, path: Path, context: object = None) -> Self:
        """Validate the tables of a file.

        Raises:
            FileFormatError: The tables do not match the model.
        """
        try:
            return cls.model_validate(tables, context=context)
        except ValidationError as error:
            raise first_issue(validation_issues(error, cls), path) from None


def require_integer(value: object) -> object:
    """Refuse values that are not of type int; a Literal alone accepts true and 1.0 as 1."""
    if type(value) is not int:
        raise ValueError
    return value


# Types of fields in several files. Error messages use each description as the expected value.
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
Register = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
RegisterValue = Annotated[int, Field(ge=-(2**31), le=2**32 - 1)]
FormatOne = Annotated[Literal[1], BeforeValidator(require_integer)]
Sign = Annotated[Literal[-1, 1], BeforeValidator(require_integer)]
