"""``ikservo where --visible-from``: what a camera, or a marker, at a point sees."""

import pytest

WHERE = "where --arm so101 --port sim:?pose=home"


def test_visible_from_option_lists_links_and_what_hides_them(run_cli):
    result = run_cli(f"{WHERE} --visible-from 0.6,0,0.1 --json").json["visible_from"]
    links = {each["link"]: each for each in result["links"]}
    assert result["eye_m"] == [0.6, 0.0, 0.1]
    assert links["shoulder"]["visible_fraction"] < 0.3
    assert "gripper" in links["shoulder"]["hidden_by"]


def test_where_visible_from_option_prints_table(run_cli):
    out = run_cli(f"{WHERE} --visible-from=-0.5,0,100mm").out
    assert "seen from (-0.500, 0.000, 0.100) m" in out
    assert next(line for line in out.splitlines() if line.startswith("gripper  ")).split()


def test_where_json_omits_visibility_without_its_option(run_cli):
    assert "visible_from" not in run_cli(f"{WHERE} --json").json


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("--visible-from 0.6,0.3", "not a point"),
        ("--visible-from 0.5,0.5,0.5 --watch", "cannot be combined with --watch"),
    ],
)
def test_visible_from_option_refuses_invalid_point_and_watch(run_cli, options, why):
    result = run_cli(f"{WHERE} {options}")
    assert result.code == 2
    assert why in result.err
