"""Results as lists of fields: keys with ``--json``, otherwise lines or columns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Generic, TypeVar

from ikservo.cli.terminal import print_json, print_lines, print_table

Record = TypeVar("Record")


@dataclass(frozen=True)
class Field(Generic[Record]):
    """One field of a result.

    Attributes:
        key: The key with ``--json``; empty if the field is not printed there.
        label: The beginning of the line, or the heading of the column; empty if the field is
            printed only with ``--json``.
        text: Formats the text, or one text per line; None uses the text of the value.
        value: Returns the value for ``--json``; None uses the attribute with the name of the key.
    """

    key: str
    label: str = ""
    text: Callable[[Record], str | list[str]] | None = None
    value: Callable[[Record], object] | None = None

    def json_value(self, record: Record) -> object:
        """Return the value that is printed with ``--json``."""
        return (self.value or attrgetter(self.key))(record)

    def texts(self, record: Record) -> list[str]:
        """Return the text of each line."""
        if self.text is None:
            value = self.json_value(record)
            value = getattr(value, "tolist", lambda: value)()  # NumPy has its own bool
            if isinstance(value, bool):
                return ["yes" if value else "no"]
            return ["" if value is None else str(value)]
        text = self.text(record)
        return [text] if isinstance(text, str) else text


Fields = Sequence[Field[Record]]
"""The fields of a result, in the order of ``--json``."""


def print_fields(
    schema: str,
    result: Record,
    fields: Fields[Record],
    *,
    json: bool,
    order: str = "",
    width: int = 10,
) -> None:
    """Print a result: one JSON object, or a line for each field with a label.

    ``order`` lists the keys of the lines; if it is empty, every field with a label gets a line.
    """
    if json:
        print_json(schema, **json_values(result, fields))
        return
    lines = (
        f"{f'{field.label} ':{width}}{text}"
        for field in _shown(fields, order)
        for text in field.texts(result)
    )
    print_lines(lines, indent=width)


def print_records(
    schema: str,
    key: str,
    records: Iterable[Record],
    fields: Fields[Record],
    *,
    json: bool,
    order: str = "",
    **more: object,
) -> None:
    """Print results of one kind: one JSON object with a list of them, or a table.

    ``order`` lists the keys of the columns; if it is empty, every field with a label gets a column.
    ``more`` contains additional fields of the JSON object.
    """
    if json:
        print_json(schema, **more, **{key: [json_values(each, fields) for each in records]})
        return
    columns = _shown(fields, order)
    rows = [[", ".join(field.texts(each)) for field in columns] for each in records]
    print_table([field.label for field in columns], rows)


def json_values(record: Record, fields: Fields[Record]) -> dict[str, object]:
    """Return the values of a record that are printed with ``--json``, by key."""
    return {field.key: field.json_value(record) for field in fields if field.key}


def _shown(fields: Fields[Record], order: str) -> Fields[Record]:
    if not order:
        return [field for field in fields if field.label]
    by_key = {field.key: field for field in fields}
    return [by_key[key] for key in order.split()]
