"""What is wrong in a file of tables: the path of the key, what is there, what should be."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from ikservo.errors import FileFormatError
from ikservo.files.quoting import quoted

__all__ = ["Complaint", "Location", "complaints_of", "first_of", "spelled"]

Location = tuple[int | str, ...]

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


class Complaint(NamedTuple):
    """One thing that is wrong, and where."""

    location: Location
    found: str
    expected: str


def first_of(complaints: Sequence[Complaint], path: Path) -> FileFormatError:
    """Return the first complaint as an error about the file; it says how many more there are."""
    first, more = complaints[0], len(complaints) - 1
    rest = f" (and {more} more to correct)" if more else ""
    return FileFormatError(path, spelled(first.location), first.found + rest, first.expected)


def complaints_of(error: ValidationError, model: type[BaseModel]) -> list[Complaint]:
    """Return what pydantic found, unknown keys first: a misspelled key is missing as well."""
    details = error.errors(include_url=False, include_context=False)
    details.sort(key=lambda detail: detail["type"] != "extra_forbidden")
    return [_complaint(detail, model) for detail in details]


def _complaint(detail: ErrorDetails, model: type[BaseModel]) -> Complaint:
    location, kind = detail["loc"], detail["type"]
    if kind == "extra_forbidden":
        return _unknown_key(location, model)
    expected = _walk(location, model)[1]
    if location[-1] == "[key]":
        return Complaint(location[:-2], f"has the key {_shown(location[-2])}", expected)
    found = "is missing" if kind == "missing" else f"is {_shown(detail['input'])}"
    return Complaint(location, found, expected)


def _unknown_key(location: Location, model: type[BaseModel]) -> Complaint:
    known = list(_walk(location[:-1], model)[0].model_fields)
    close = difflib.get_close_matches(str(location[-1]), known, n=1)
    listing = ", ".join(known)
    expected = f"{close[0]} (known here: {listing})" if close else f"one of {listing}"
    return Complaint(location, "is not a known key", expected)


def _walk(location: Location, model: type[BaseModel]) -> tuple[type[BaseModel], str]:
    """Follow a location down; return the last model on the way and the last description."""
    expected, keys = "", iter(location)
    for key in keys:
        field = model.model_fields.get(str(key))
        if field is None:
            break
        expected = field.description or ""
        inner = _model_in(field.annotation)
        if inner is None:
            break
        model = inner
        if field.annotation is not inner:
            next(keys, None)  # the index in a list of tables, or the name of a table
    return model, expected


def _model_in(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model_in, get_args(annotation))), None)


def _shown(value: object) -> str:
    """Return a value as TOML would write it, cut short."""
    match value:
        case bool():
            return str(value).lower()
        case str():
            return quoted(value)
        case int() if value.bit_length() > 64:
            return "a huge number"
        case Mapping():
            return "a table"
        case list():
            return "a list"
        case _:
            return str(value)


def spelled(location: Location) -> str:
    """Return ``joints[2].servo.id``; keys that are not bare are quoted."""
    steps = [f"[{key}]" if isinstance(key, int) else f".{_key(key)}" for key in location]
    return "".join(steps).removeprefix(".")


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) and len(key) <= 64 else quoted(key)
