"""``ikservo workspace``: counts, a test of a point, a picture; nothing moves."""

import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest

P2 = "workspace --arm planar2 --slice top --cell 20mm"


def test_workspace_slice_reports_cells_and_area_in_m2(run_cli):
    lines = run_cli(P2).out.splitlines()
    assert lines[0] == "Two servos in a plane, top: the plane at a height of 0.050 m"
    assert "cells of 20 mm" in lines[1]
    assert lines[1].endswith("m²")
    assert lines[2].startswith("x  -0.")


def test_workspace_slice_json_has_area_and_outline(run_cli):
    answer = run_cli(f"{P2} --json").json
    assert answer["schema"] == "ikservo/workspace/1"
    assert answer["slice"] == "top"
    assert answer["area_m2"] == pytest.approx(answer["reachable_cells"] * answer["cell_m"] ** 2)
    assert answer["upper_m"][0] == pytest.approx(0.3, abs=0.02)
    assert len(answer["outline_m"]) == 2
    np.testing.assert_allclose(np.array(answer["T_world_grid"])[:3, 3], [0, 0, 0.05])


def test_workspace_without_a_slice_is_a_volume(run_cli):
    answer = run_cli("workspace --arm planar2 --cell 3cm --json").json
    assert answer["slice"] is None
    assert answer["volume_m3"] == pytest.approx(answer["reachable_cells"] * 0.03**3)
    assert "outline_m" not in answer


def test_workspace_slice_above_planar_arm_is_empty(run_cli):
    answer = run_cli(f"{P2} --height 0.3 --json").json
    assert answer["reachable_cells"] == 0
    assert answer["lower_m"] is None


def test_workspace_slice_is_turned_by_yaw(run_cli):
    answer = run_cli("workspace --arm planar2 --slice side --yaw 90 --cell 2cm --json").json
    np.testing.assert_allclose(np.array(answer["T_world_grid"])[:3, 0], [0, 1, 0], atol=1e-12)


def test_workspace_point_that_is_reachable_is_inside(run_cli):
    result = run_cli("workspace --arm so101 --point 0.25 0.05 150mm")
    assert result.code == 0
    assert result.out == "(0.250, 0.050, 0.150) m  inside\n"


def test_workspace_point_out_of_reach_exits_7_with_distance(run_cli):
    result = run_cli("workspace --arm planar2 --point 0.3 0.4 50mm")
    assert result.code == 7
    assert "outside: the links are too short" in result.out
    assert "nearest  (0.180, 0.240, 0.050) m, 200.0 mm away" in result.out


def test_workspace_point_json_has_its_distance(run_cli):
    result = run_cli("workspace --arm planar2 --point -0.5 0 0.05 --json")
    assert result.code == 7
    assert result.json["inside"] is False
    assert result.json["point_m"] == [-0.5, 0.0, 0.05]
    assert 0.2 < result.json["distance_m"] < 0.3
    assert "joint1 at its" in result.json["binding"][0]


def test_workspace_point_inside_has_distance_zero(run_cli):
    answer = run_cli("workspace --arm planar2 --point 0.2 0.1 0.05 --json").json
    assert answer["inside"] is True
    assert answer["distance_m"] == 0.0


def test_workspace_reports_point_and_slice_together(run_cli):
    answer = run_cli(f"{P2} --point 0.2 0.1 0.05 --json").json
    assert answer["inside"] is True
    assert answer["slice"] == "top"


@pytest.mark.parametrize("words", ["--slice top", "--cell 40mm"])
def test_workspace_plot_is_an_svg_with_arm_title(run_cli, tmp_path, words):
    pytest.importorskip("matplotlib")
    file = tmp_path / "reach.svg"
    result = run_cli(f"workspace --arm planar2 --cell 4cm {words} --plot {file}")
    assert result.code == 0
    root = ET.parse(file).getroot()
    assert root.tag.endswith("svg")
    assert "Two servos in a plane" in file.read_text()


def test_workspace_plot_can_be_written_as_png(run_cli, tmp_path):
    pytest.importorskip("matplotlib")
    file = tmp_path / "reach.png"
    assert run_cli(f"{P2} --plot {file} --point 0.5 0 0.05").code == 7
    assert file.read_bytes().startswith(b"\x89PNG")


def test_workspace_plot_without_matplotlib_says_what_to_install(run_cli, tmp_path, monkeypatch):
    for name in ("matplotlib", "matplotlib.figure"):
        monkeypatch.setitem(sys.modules, name, None)
    result = run_cli(f"{P2} --plot {tmp_path}/reach.svg")
    assert result.code == 1
    assert "[plot]" in result.err
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
        ("--slice top --plot reach.pdf", "neither an .svg nor a .png"),
        ("--point 0.1 0.2 up", "'up' is not a length"),
        ("--point 0.1 0.2", "--point"),
    ],
)
def test_workspace_refuses_invalid_options_with_one_message(run_cli, words, message):
    result = run_cli(f"workspace --arm planar2 {words}")
    assert result.code == 2
    assert message in result.err
    assert result.out == ""
    assert "Traceback" not in result.err


def test_workspace_plot_refuses_missing_folder_at_once(run_cli, tmp_path):
    pytest.importorskip("matplotlib")
    result = run_cli(f"{P2} --plot {tmp_path}/nowhere/reach.svg")
    assert result.code == 2
    assert "nowhere" in result.err
    assert result.out == ""


def test_workspace_command_without_arm_lists_arms(run_cli):
    result = run_cli("workspace --slice top")
    assert result.code == 2
    assert "so101" in result.err


def test_workspace_point_below_table_is_outside_with_reason(run_cli):
    result = run_cli("workspace --arm so101 --point 0.2 0 -0.05")
    assert result.code == 7
    assert "outside: every posture found collides" in result.out


def test_workspace_point_below_table_is_inside_without_checks(run_cli):
    assert run_cli("workspace --arm so101 --point 0.2 0 -0.05 --no-collision").code == 0


def test_workspace_slice_excludes_points_blocked_by_table(run_cli):
    side = "workspace --arm so101 --slice side --cell 2cm --json"
    checked, plain = run_cli(side).json, run_cli(f"{side} --no-collision").json
    assert checked["lower_m"][1] > -0.01
    assert plain["lower_m"][1] < -0.1
    assert checked["reachable_cells"] < plain["reachable_cells"]
