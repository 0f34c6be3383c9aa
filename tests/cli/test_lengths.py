"""Every option asks about a length without a unit that could be in millimetres."""

import pytest
import typer

from ikservo.cli.quantities import parse_coordinate_m, parse_length_m, parse_point_m


@pytest.mark.parametrize("words", [
    "draw star.csv --width 80", "draw star.csv --lift 5", "look 3 4 --height 30",
    "move 0.2 0 0.1 --blend 5", "arc 0.2 0 0.1 --center 200,0,100", "gripper 30",
    "move 0.2 0 0.1 --keep-above 30", "camera check --within 3",
    "calibrate --touch --block-height 40",
])  # fmt: skip
def test_length_option_without_unit_is_refused_with_suggestion(run_cli, words):
    done = run_cli(f"{words} --arm so101 --port sim")
    assert (done.code, "Did you mean" in done.err) == (2, True), done.err


@pytest.mark.parametrize("text", ["1m", "0.9", "-0.5", "900mm", "99cm", ".8"])
def test_length_with_unit_or_bare_number_below_1_m_is_accepted(text):
    assert parse_length_m(text) == parse_coordinate_m(text)


def test_length_without_unit_error_suggests_both_units():
    with pytest.raises(typer.BadParameter, match="Did you mean -80mm") as caught:
        parse_length_m("\N{MINUS SIGN}80")
    assert "-80m" in str(caught.value)
    with pytest.raises(typer.BadParameter, match="250mm"):
        parse_point_m("250,0,0.1")
