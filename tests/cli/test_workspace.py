"""``ikservo workspace``: counts, a test of a point, a picture; nothing moves."""

import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest

P2 = "workspace --arm planar2 --slice top --cell 20mm"


def test_a_slice_is_told_in_cells_and_square_metres(say):
    lines = say(P2).out.splitlines()
    assert lines[0] == "Two servos in a plane, top: the plane at a height of 0.050 m"
    assert "cells of 20 mm" in lines[1]
    assert lines[1].endswith("m²")
    assert lines[2].startswith("x  -0.")


def test_the_json_of_a_slice_has_its_numbers_and_its_outline(say):
    answer = say(f"{P2} --json").json
    assert answer["schema"] == "ikservo/workspace/1"
    assert answer["slice"] == "top"
    assert answer["area_m2"] == pytest.approx(answer["reachable_cells"] * answer["cell_m"] ** 2)
    assert answer["upper_m"][0] == pytest.approx(0.3, abs=0.02)
    assert len(answer["outline_m"]) == 2
    np.testing.assert_allclose(np.array(answer["T_world_grid"])[:3, 3], [0, 0, 0.05])


def test_without_a_slice_it_is_the_volume(say):
    answer = say("workspace --arm planar2 --cell 3cm --json").json
    assert answer["slice"] is None
    assert answer["volume_m3"] == pytest.approx(answer["reachable_cells"] * 0.03**3)
    assert "outline_m" not in answer


def test_height_moves_the_slice_out_of_the_arms_plane(say):
    answer = say(f"{P2} --height 0.3 --json").json
    assert answer["reachable_cells"] == 0
    assert answer["lower_m"] is None


def test_yaw_turns_the_slice(say):
    answer = say("workspace --arm planar2 --slice side --yaw 90 --cell 2cm --json").json
    np.testing.assert_allclose(np.array(answer["T_world_grid"])[:3, 0], [0, 1, 0], atol=1e-12)


def test_a_reachable_point_is_inside_and_exit_0(say):
    said = say("workspace --arm so101 --point 0.25 0.05 150mm")
    assert said.code == 0
    assert said.out == "(0.250, 0.050, 0.150) m  inside\n"


def test_an_unreachable_point_is_exit_7_with_its_distance(say):
    said = say("workspace --arm planar2 --point 0.3 0.4 50mm")
    assert said.code == 7
    assert "outside: the links are too short" in said.out
    assert "nearest  (0.180, 0.240, 0.050) m, 200.0 mm away" in said.out


def test_the_json_of_a_point_has_its_distance(say):
    said = say("workspace --arm planar2 --point -0.5 0 0.05 --json")
    assert said.code == 7
    assert said.json["inside"] is False
    assert said.json["point_m"] == [-0.5, 0.0, 0.05]
    assert 0.2 < said.json["distance_m"] < 0.3
    assert "joint1 at its" in said.json["binding"][0]


def test_a_point_inside_is_at_no_distance(say):
    answer = say("workspace --arm planar2 --point 0.2 0.1 0.05 --json").json
    assert answer["inside"] is True
    assert answer["distance_m"] == 0.0


def test_a_point_and_a_slice_are_both_answered(say):
    answer = say(f"{P2} --point 0.2 0.1 0.05 --json").json
    assert answer["inside"] is True
    assert answer["slice"] == "top"


@pytest.mark.parametrize("words", ["--slice top", "--cell 40mm"])
def test_the_picture_is_an_svg_with_the_arm_and_its_title(say, tmp_path, words):
    pytest.importorskip("matplotlib")
    file = tmp_path / "reach.svg"
    said = say(f"workspace --arm planar2 --cell 4cm {words} --plot {file}")
    assert said.code == 0
    root = ET.parse(file).getroot()
    assert root.tag.endswith("svg")
    assert "Two servos in a plane" in file.read_text()


def test_the_picture_may_be_a_png_with_the_point_marked(say, tmp_path):
    pytest.importorskip("matplotlib")
    file = tmp_path / "reach.png"
    assert say(f"{P2} --plot {file} --point 0.5 0 0.05").code == 7
    assert file.read_bytes().startswith(b"\x89PNG")


def test_without_matplotlib_the_extra_is_named(say, tmp_path, monkeypatch):
    for name in ("matplotlib", "matplotlib.figure"):
        monkeypatch.setitem(sys.modules, name, None)
    said = say(f"{P2} --plot {tmp_path}/reach.svg")
    assert said.code == 1
    assert "ikservo[plot]" in said.err
    assert not (tmp_path / "reach.svg").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--slice back", "back"),
        ("--slice side --height 0.1", "--height needs --slice top"),
        ("--height 0.1", "--height needs --slice top"),
        ("--slice top --yaw 10", "--yaw needs"),
        ("--slice top --height nan", "'nan' is not a length"),
        ("--slice top --cell 0", "length above 0"),
        ("--slice top --cell 1e-7", "larger cells"),
        ("--slice top --plot reach.pdf", "neither .svg nor .png"),
        ("--point 0.1 0.2 up", "'up' is not a length"),
        ("--point 0.1 0.2", "--point"),
    ],
)
def test_one_clear_message_for_what_makes_no_sense(say, words, message):
    said = say(f"workspace --arm planar2 {words}")
    assert said.code == 2
    assert message in said.err
    assert said.out == ""
    assert "Traceback" not in said.err


def test_a_folder_that_is_not_there_is_refused_before_any_work(say, tmp_path):
    pytest.importorskip("matplotlib")
    said = say(f"{P2} --plot {tmp_path}/nowhere/reach.svg")
    assert said.code == 2
    assert "nowhere" in said.err
    assert said.out == ""


def test_without_an_arm_the_arms_are_listed(say):
    said = say("workspace --slice top")
    assert said.code == 2
    assert "so101" in said.err


def test_a_point_below_the_table_is_outside_and_says_why(say):
    said = say("workspace --arm so101 --point 0.2 0 -0.05")
    assert said.code == 7
    assert "outside: every posture found collides" in said.out


def test_without_the_collision_check_a_point_below_the_table_is_in_reach(say):
    assert say("workspace --arm so101 --point 0.2 0 -0.05 --no-collision").code == 0


def test_what_the_table_forbids_is_left_out_of_a_slice(say):
    side = "workspace --arm so101 --slice side --cell 2cm --json"
    checked, plain = say(side).json, say(f"{side} --no-collision").json
    assert checked["lower_m"][1] > -0.01
    assert plain["lower_m"][1] < -0.1
    assert checked["reachable_cells"] < plain["reachable_cells"]
