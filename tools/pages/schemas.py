"""Pages of file formats and messages, from the pydantic models that read them."""

from __future__ import annotations

import inspect
import types
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from pages.markdown import code, table

__all__ = ["describe_type", "model_sections", "models_below"]


def models_below(model: type[BaseModel]) -> list[type[BaseModel]]:
    """Return a model and every model that its fields contain, each once, in reading order."""
    found: list[type[BaseModel]] = []
    waiting = [model]
    while waiting:
        current = waiting.pop(0)
        if current not in found:
            found.append(current)
            for field in current.model_fields.values():
                waiting += list(_models_in(field.annotation))
    return found


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def model_sections(model: type[BaseModel], level: int = 2) -> str:
    """Return a section for a model and each that it contains, with a table of its keys."""
    return "\n\n".join(_section(each, "#" * level) for each in models_below(model))


def _section(model: type[BaseModel], marks: str) -> str:
    title, _, rest = (inspect.getdoc(model) or "").replace("``", "`").partition("\n")
    rows = [(code(name), *_row(field)) for name, field in model.model_fields.items()]
    parts = [f"{marks} {title.rstrip('.')}", rest.strip()]
    parts.append(table(["key", "type", "needed", "expected"], rows))
    return "\n\n".join(part for part in parts if part)


def _row(field: FieldInfo) -> tuple[str, str, str]:
    return describe_type(field), _default(field), field.description or ""


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "yes"
    value = cast("object", field.get_default(call_default_factory=True))
    if value is None or isinstance(value, BaseModel) or value in ((), {}):
        return "no"
    return f"no; default {code(_toml(value))}"


def _toml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def describe_type(field: FieldInfo) -> str:
    """Return the type of a field and its bounds, in words of TOML and JSON."""
    bounds = [_bound(each) for each in _constraints(field)]
    return ", ".join([_words(field.annotation), *(bound for bound in bounds if bound)])


def _constraints(field: FieldInfo) -> Iterator[object]:
    yield from field.metadata
    for argument in get_args(field.annotation):
        if get_origin(argument) is Annotated:
            for each in get_args(argument)[1:]:
                yield from getattr(each, "metadata", [each])


_SIGNS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}


def _bound(constraint: object) -> str:
    found = [
        f"{words} {getattr(constraint, name):,}"
        for name, words in _SIGNS.items()
        if getattr(constraint, name, None) is not None
    ]
    if getattr(constraint, "min_length", None) is not None:
        found.append(f"length at least {cast('Any', constraint).min_length}")
    if getattr(constraint, "max_length", None) is not None:
        found.append(f"length at most {cast('Any', constraint).max_length}")
    return ", ".join(found)


_NAMES: Mapping[object, str] = {
    str: "text",
    int: "whole number",
    float: "number",
    bool: "true or false",
}


def _words(annotation: Any) -> str:  # noqa: ANN401  # anything that stands in an annotation
    origin, arguments = get_origin(annotation), get_args(annotation)
    if annotation in _NAMES:
        return _NAMES[annotation]
    if origin is Annotated:
        return _words(arguments[0])
    if origin is Literal:
        return " or ".join(code(value) for value in arguments)
    if origin in (Union, types.UnionType):
        return " or ".join(_words(each) for each in arguments if each is not types.NoneType)
    return _collection(annotation, origin, arguments)


def _collection(annotation: Any, origin: Any, arguments: tuple[Any, ...]) -> str:  # noqa: ANN401
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "table"
    if origin is tuple and arguments[-1] is not Ellipsis:
        return f"list of {len(arguments)} numbers"
    if origin in (tuple, list):
        return f"list of: {_words(arguments[0])}"
    return f"table of: {_words(arguments[1])}" if len(arguments) == 2 else "table"
