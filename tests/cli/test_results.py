"""A result is printed from one table of fields, as JSON or as text."""

import json
from dataclasses import dataclass

import numpy as np
import pytest

from ikservo.cli.results import Field, print_fields, print_records


@dataclass(frozen=True)
class Cup:
    """A measurement."""

    size_m: float
    full: object
    notes: tuple[str, ...] = ()


FIELDS = (
    Field("size_m", "size", lambda cup: f"{1000 * cup.size_m:.0f} mm"),
    Field("full", "full"),
    Field("name", value=lambda cup: "cup"),
    Field("", "half", lambda cup: f"{500 * cup.size_m:.0f} mm"),
    Field("notes", "note", lambda cup: list(cup.notes)),
)


def test_result_json_keys_are_in_order_of_field_table(capsys):
    print_fields("cup", Cup(0.1, True, ("old",)), FIELDS, json=True)
    printed = json.loads(capsys.readouterr().out)
    assert list(printed) == ["schema", "size_m", "full", "name", "notes"]
    assert printed == {
        "schema": "ikservo/cup/1",
        "size_m": 0.1,
        "full": True,
        "name": "cup",
        "notes": ["old"],
    }


@pytest.mark.parametrize(
    ("full", "text"), [(True, "yes"), (np.bool_(False), "no"), (None, ""), (1, "1")]
)
def test_result_text_has_one_line_per_field_and_item(capsys, full, text):
    print_fields("cup", Cup(0.1, full, ("old", "blue")), FIELDS, json=False, width=6)
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    rows = ["size  100 mm", f"full  {text}".rstrip(), "half  50 mm", "note  old", "note  blue"]
    assert lines == rows


def test_result_text_contains_only_selected_fields_in_order(capsys):
    print_fields("cup", Cup(0.1, True), FIELDS, json=False, order="full size_m")
    assert capsys.readouterr().out == "full      yes\nsize      100 mm\n"


def test_result_records_are_printed_as_json_list(capsys):
    print_records("cups", "cups", [Cup(0.1, True)], FIELDS[:2], json=True, at="home")
    printed = json.loads(capsys.readouterr().out)
    assert printed == {
        "schema": "ikservo/cups/1",
        "at": "home",
        "cups": [{"size_m": 0.1, "full": True}],
    }


def test_result_records_are_printed_as_text_table(capsys):
    cups = [Cup(0.1, True, ("old", "blue")), Cup(0.2, False)]
    print_records("cups", "cups", cups, FIELDS, json=False, order="full notes size_m")
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows == [["full", "note", "size"], ["yes", "old,", "blue", "100", "mm"],
                    ["no", "200", "mm"]]  # fmt: skip
