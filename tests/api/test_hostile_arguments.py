"""Whatever a program passes, an error of ikservo says so in a short, printable sentence."""

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError, IkservoError, RefusedError, UnknownNameError, shown


class Angry:
    """A value whose repr() raises an error."""

    def __repr__(self):
        raise RuntimeError


def nested(levels):
    found = []
    for _ in range(levels):
        found = [found]
    return found


HOSTILE = [
    10**5000, nested(3000), "x" * 100_000, "\x1b[2J", "\ud800", [], {}, {1, 2}, np.zeros((2, 3)),
    np.array([1j]), Angry(),
]  # fmt: skip


def test_value_quoted_in_message_has_at_most_201_characters():
    assert all(len(shown(value)) <= 201 for value in HOSTILE)
    assert shown(Angry()) == "a value of type Angry"
    assert shown(0.5) == "0.5"


def test_error_escapes_control_characters_in_quoted_text():
    error = RefusedError("\x1b[2J\u202eA\ud800 file", "See\x07 it.")
    assert str(error) == "\\x1b[2J\\u202eA\\ud800 file\nSee\\x07 it."
    assert str(BadValueError("It", 10**5000, "less")).startswith("It is a value of type int.")
    assert len(str(UnknownNameError("link", "x" * 10**6, ["tip"]))) < 400


@pytest.mark.parametrize("index", range(len(HOSTILE)))
def test_functions_refuse_hostile_values_with_short_messages(index):
    value = HOSTILE[index]
    calls = [
        lambda: ikservo.load_model(value),
        lambda: ikservo.load_model("koch", tip=value),
        lambda: ikservo.open_arm("koch", port=value),
        lambda: ikservo.read_drawing("none.csv", unit=value),
        lambda: ikservo.read_drawing(value),
        lambda: ikservo.solve("koch", (0.2, 0.0, 0.1), method=value),
        lambda: ikservo.solve("koch", (0.2, 0.0, 0.1), tolerance=value),
        lambda: ikservo.solve("koch", (0.2, 0.0, 0.1), restarts=value),
        lambda: ikservo.solve("koch", (0.2, 0.0, 0.1), turn_weight_m_rad=value),
        lambda: ikservo.solve_batch("koch", [(0.2, 0.0, 0.1)], options=value),
        lambda: ikservo.solve_batch("koch", [(0.2, 0.0, 0.1)], workers=value),
        lambda: ikservo.Solver("koch", kind=value),
        lambda: ikservo.Solver("koch", tolerance=value),
        lambda: ikservo.Solver("koch", frame=value),
    ]
    for number, call in enumerate(calls):
        with pytest.raises(IkservoError) as caught:
            call()
        text = str(caught.value)
        assert len(text) < 8200, number
        assert text.replace("\n", "").isprintable(), number


@pytest.mark.parametrize("value", [np.zeros((2, 3)), "yes", 1, None])
def test_boolean_arguments_accept_only_true_or_false(value, tmp_path):
    with ikservo.open_arm("koch", port="sim:?pose=home") as arm:
        for call in (
            lambda: arm.teach("q", hold=value),
            lambda: arm.record(tmp_path / "r.jsonl", duration_s=0.1, overwrite=value),
        ):
            with pytest.raises(IkservoError, match="True or False"):
                call()


def test_record_refuses_file_name_too_long():
    with ikservo.open_arm("koch", port="sim:?pose=home") as arm, pytest.raises(IkservoError):
        arm.record("x" * 5000, duration_s=0.1, overwrite=True)
