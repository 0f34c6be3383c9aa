"""Tables and JSON: no unknown keys, no guessed types, no invalid numbers."""

import pytest
from pydantic import ValidationError

from ikservo.files.reading import parse_json
from ikservo.files.validation import StrictModel


class Row(StrictModel):
    name: str
    size: float


GOOD = {"name": "a", "size": 1.5}


@pytest.mark.parametrize(
    "change", [{"more": 1}, {"size": "1.5"}, {"size": float("nan")}, {"size": float("inf")}]
)
def test_strict_schema_refuses_unknown_keys_types_and_nan(change):
    assert Row.model_validate(GOOD).size == 1.5
    with pytest.raises(ValidationError):
        Row.model_validate(GOOD | change)


def test_strict_schema_object_is_immutable():
    with pytest.raises(ValidationError):
        Row.model_validate(GOOD).size = 2.0


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('{"a": 1, "a": 2}', "a key appears twice"),
        ('{"a": {"b": 1, "b": 1}}', "a key appears twice"),
        ("[NaN]", "it contains NaN"),
        ("[-Infinity]", "it contains -Infinity"),
        ("{", "Expecting"),
        (b"\xff", "utf-8"),
    ],
)
def test_json_with_duplicate_keys_or_nan_is_refused(text, why):
    with pytest.raises(ValueError, match=why):
        parse_json(text)


def test_valid_json_file_is_read():
    assert parse_json(b'{"a": [1, 2.5, null]}') == {"a": [1, 2.5, None]}
