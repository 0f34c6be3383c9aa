"""``ikservo solve`` with every method, every solution, every iterate, and as a picture."""

import json
import math
import re

import numpy as np
import pytest

import ikservo
from ikservo.cli.plots import arm_polyline
from ikservo.model import load_model
from ikservo.remedies import install_command
from tests.oracle import ARMS, tip_from_joints

POINT = "solve 0.25 0.05 0.15 --arm so101"
FLAT = "solve 0.15 0.15 0.05 --arm planar3"
SO101 = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
LECTURE = ("pseudo_inverse", "transpose", "ccd")


def tip_of_so101(q_rad):
    return tip_from_joints("so101", dict(zip(SO101, q_rad, strict=True)))


@pytest.mark.parametrize("method", LECTURE)
def test_solve_method_option_uses_chosen_method(run_cli, method):
    answer = run_cli(f"{POINT} --method {method} --json").json
    assert answer["method"] == method
    np.testing.assert_allclose(tip_of_so101(answer["q_rad"]), (0.25, 0.05, 0.15), atol=1e-5)


def test_solve_compare_has_a_row_for_every_method(run_cli):
    rows = [line.split() for line in run_cli(f"{POINT} --compare").out.splitlines()]
    assert rows[0] == ["method", "reached", "iterations", "time", "error"]
    assert [row[0] for row in rows[1:]] == ["bounded", "closed_form", *LECTURE]
    assert {row[1] for row in rows[1:]} == {"yes"}


def test_solve_compare_has_units_for_time_and_error(run_cli):
    row = run_cli(f"{POINT} --compare").out.splitlines()[-1]
    assert re.fullmatch(r"ccd +yes +\d+ +[\d.]+ ms +[\d.]+ mm", row.strip())


def test_solve_compare_errors_match_forward_kinematics(run_cli):
    for entry in run_cli(f"{POINT} --compare --json").json["methods"]:
        tip = tip_of_so101(entry["q_rad"])
        gap_m = float(np.linalg.norm(tip - (0.25, 0.05, 0.15)))
        assert entry["position_error_m"] == pytest.approx(gap_m, abs=1e-9)
        assert entry["time_s"] > 0


def test_solve_compare_json_has_the_expected_keys(run_cli):
    answer = run_cli(f"{POINT} --compare --json").json
    assert answer["schema"] == "ikservo/compare/1"
    assert answer["target_m"] == [0.25, 0.05, 0.15]
    assert set(answer["methods"][0]) == {
        "method", "answered_by", "reached", "iterations", "time_s", "position_error_m",
        "orientation_error_rad", "q_rad", "nearest_m", "binding", "compiled",
    }  # fmt: skip


def test_solve_compare_out_of_reach_exits_7_with_each_error(run_cli):
    result = run_cli("solve 0.9 0.9 0.05 --arm planar3 --compare --json")
    assert result.code == 7
    best = math.hypot(0.9, 0.9) - 0.32
    for entry in result.json["methods"]:
        assert not entry["reached"]
        assert entry["position_error_m"] == pytest.approx(best, abs=1e-3)


@pytest.mark.full
def test_solve_compare_names_limits_in_effect_and_their_source(run_cli):
    question = "solve --arm so101 --json"
    compared, alone = (
        run_cli(f"{question} {how} -- 0.02 0 -0.2").json
        for how in ("--compare", "--method bounded")
    )
    bounded = next(entry for entry in compared["methods"] if entry["method"] == "bounded")
    assert alone["binding"]
    assert bounded["binding"] == alone["binding"]
    assert compared["limit_from"] == alone["limit_from"]


def test_solve_compare_names_fallback_method(run_cli):
    result = run_cli("solve 0.9 0 0.2 --arm so101 --compare")
    assert "closed_form (by bounded)" in result.out


def test_solve_compare_with_direction_has_an_angle_column(run_cli):
    result = run_cli(f"{FLAT} --direction 1,0,0 --tool-axis x --compare")
    assert result.out.splitlines()[0].split()[-1] == "angle"
    assert result.out.splitlines()[1].endswith("°")


def test_solve_reaches_requested_direction(run_cli):
    answer = run_cli(f"{FLAT} --direction 0,1,0 --tool-axis x --json").json
    assert answer["reached"]
    assert sum(answer["q_rad"]) == pytest.approx(math.pi / 2, abs=1e-4)


def test_solve_direction_may_start_with_negative_number(run_cli):
    words = f"{FLAT} --direction -0.5,1,0 --tool-axis x --json"
    assert sum(run_cli(words).json["q_rad"]) == pytest.approx(math.atan2(1.0, -0.5), abs=1e-4)


def test_solve_reports_impossible_direction_in_degrees(run_cli):
    result = run_cli(f"{FLAT} --direction 0,0,1 --tool-axis x")
    assert result.code == 7
    assert "out of reach: the links are too short" in result.out
    assert "0.0 mm and 90.0° away" in result.out


def test_solve_all_lists_distinct_solutions_that_reach_target(run_cli):
    found = run_cli(f"{FLAT} --direction 1,0,0 --tool-axis x --all --json").json
    assert found["schema"] == "ikservo/solutions/1"
    joints = [solution["q_rad"] for solution in found["solutions"]]
    assert len(joints) == 2
    names = load_model("planar3").chain.names
    for q in joints:
        tip = tip_from_joints("planar3", dict(zip(names, q, strict=True)))
        np.testing.assert_allclose(tip, (0.15, 0.15, 0.05), atol=1e-5)
    assert np.abs(np.subtract(*joints)).max() > 0.1


def test_solve_all_prints_a_table_in_degrees(run_cli):
    lines = run_cli(f"{FLAT} --all").out.splitlines()
    assert lines[0].split() == ["#", "joint1", "joint2", "joint3", "error"]
    assert re.fullmatch(r"1( +-?[\d.]+°){3} +0\.0000 mm", lines[1].strip())


def test_solve_all_reports_one_parameter_family_of_solutions(run_cli):
    assert "one-parameter family" in run_cli(f"{FLAT} --all").out


def test_solve_all_of_unreachable_point_gives_nearest_point(run_cli):
    result = run_cli("solve 0.9 0 0.05 --arm planar3 --all")
    assert result.code == 7
    assert "mm away" in result.out


def test_solve_all_of_unreachable_point_has_empty_json_list(run_cli):
    result = run_cli("solve 0.9 0 0.05 --arm planar3 --all --json")
    assert result.code == 7
    assert result.json["solutions"] == []


def test_solve_all_refuses_arm_without_closed_form(run_cli, skewed):
    result = run_cli(f"solve 0.1 0.1 0.1 --arm {skewed} --tip tip --all")
    assert result.code == 2
    assert "has no closed-form solution" in result.err


def test_solve_compare_omits_closed_form_if_arm_has_none(run_cli, skewed):
    result = run_cli(f"solve 0.1 0.1 0.1 --arm {skewed} --tip tip --compare --json")
    assert [e["method"] for e in result.json["methods"]] == ["bounded", *LECTURE]


@pytest.fixture
def skewed(tmp_path):
    """Return a .urdf with skew joint axes, one of them a slide."""
    text = '<robot name="skewed">' + "".join(f'<link name="{n}"/>' for n in ("a", "b", "c", "tip"))
    for kind, parent, child, axis in (
        ("revolute", "a", "b", "0 0 1"), ("prismatic", "b", "c", "1 1 0"),
        ("revolute", "c", "tip", "1 0.3 0"),
    ):  # fmt: skip
        text += (
            f'<joint name="{parent}{child}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="0.1 0.05 0.02"/><axis xyz="{axis}"/>'
            '<limit lower="-0.5" upper="0.5" effort="1" velocity="1"/></joint>'
        )
    (tmp_path / "skewed.urdf").write_text(text + "</robot>")
    return tmp_path / "skewed.urdf"


def traced(result):
    return [json.loads(line) for line in result.out.splitlines()]


@pytest.mark.parametrize("method", ["bounded", *LECTURE])
def test_solve_trace_prints_one_object_per_iteration(run_cli, method):
    lines = traced(run_cli(f"{POINT} --method {method} --trace"))
    assert [line["iteration"] for line in lines] == list(range(len(lines)))
    assert set(lines[0]) == {
        "schema", "method", "iteration", "q_rad", "position_error_m", "orientation_error_rad",
    }  # fmt: skip
    assert {line["schema"] for line in lines} == {"ikservo/trace/1"}


def test_solve_trace_begins_at_home_and_ends_at_the_target(run_cli):
    lines = traced(run_cli(f"{POINT} --method ccd --trace"))
    assert np.degrees(lines[0]["q_rad"]).round(6).tolist() == [0, -45, 45, 60, 0]
    assert lines[-1]["position_error_m"] <= 1e-5


def test_solve_trace_errors_match_its_joints(run_cli):
    for line in traced(run_cli(f"{POINT} --method transpose --trace"))[::10]:
        gap_m = float(np.linalg.norm(tip_of_so101(line["q_rad"]) - (0.25, 0.05, 0.15)))
        assert line["position_error_m"] == pytest.approx(gap_m, abs=1e-9)


def test_solve_compare_with_trace_has_every_method(run_cli):
    lines = traced(run_cli(f"{FLAT} --compare --trace"))
    assert {line["method"] for line in lines} == {"bounded", "closed_form", *LECTURE}


def test_solve_trace_that_does_not_converge_exits_7(run_cli):
    assert run_cli("solve 0.9 0 0.05 --arm planar3 --method ccd --trace").code == 7


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--all --compare", "--all has no iterations"),
        ("--all --trace", "--all has no iterations"),
        ("--all --method ccd", "--all chooses the method"),
        ("--compare --method ccd", "--compare chooses the method"),
        ("--plot arm.gif", "arm.gif is neither an .svg nor a .png file"),
        ("--plot nowhere/arm.svg", "There is no folder nowhere"),
        ("--direction 1,0", "'1,0' is not a direction"),
        ("--direction 1,0,up", "'1,0,up' is not a direction"),
        ("--direction 0,0,0", "The wanted direction is zero"),
        ("--tool-axis w", "'w' is not a direction"),
    ],
)
def test_solve_refuses_contradictory_options_before_solving(run_cli, words, message):
    result = run_cli(f"{FLAT} {words}")
    assert result.code == 2
    assert message in result.err
    assert result.out == ""


def test_solve_plot_without_matplotlib_says_what_to_install(run_cli, monkeypatch, tmp_path):
    monkeypatch.setattr("ikservo.cli.plots.find_spec", lambda _: None)
    result = run_cli(f"{FLAT} --plot {tmp_path}/arm.svg")
    assert result.code == 1
    assert install_command("plot") in result.err
    assert result.out == ""


def words_of(svg):
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg.read_text())


@pytest.mark.full
def test_solve_compare_plot_names_every_method_and_units(run_cli, tmp_path):
    file = tmp_path / "methods.svg"
    result = run_cli(f"{POINT} --compare --plot {file}")
    assert result.err.endswith(f"Picture: {file}\n")
    words = words_of(file)
    assert {"before", "bounded", "closed_form", *LECTURE} <= set(words)
    assert {"x [m]", "y [m]", "z [m]", "distance from the base axis [m]", "iteration",
            "position error [mm]"} <= set(words)  # fmt: skip
    assert "SO-101 follower: the tip to (0.250, 0.050, 0.150) m" in words


@pytest.mark.full
def test_solve_plot_with_direction_has_an_angle_curve(run_cli, tmp_path):
    file = tmp_path / "arm.svg"
    run_cli(f"{FLAT} --direction 1,0,0 --tool-axis x --method ccd --plot {file}")
    assert "orientation error [°]" in words_of(file)


@pytest.mark.full
def test_solve_plot_of_planar_arm_shows_only_the_top_view(run_cli, tmp_path):
    file = tmp_path / "arm.svg"
    run_cli(f"{FLAT} --method ccd --plot {file}")
    assert "z [m]" not in words_of(file)


def test_solve_plot_out_of_reach_shows_the_distance(run_cli, tmp_path):
    file = tmp_path / "arm.svg"
    assert run_cli(f"solve 0.9 0 0.05 --arm planar3 --method ccd --plot {file}").code == 7
    assert any(re.fullmatch(r"ccd, 5\d\d\.\d mm short", word) for word in words_of(file))


def test_plot_of_solve_all_has_no_iteration_curves(run_cli, tmp_path):
    file = tmp_path / "arm.svg"
    run_cli(f"{FLAT} --all --plot {file}")
    words = words_of(file)
    assert {"solution 1", "solution 2"} <= set(words)
    assert "iteration" not in words


@pytest.mark.campaign
def test_solve_plot_is_deterministic(run_cli, tmp_path):
    first, second = tmp_path / "a.svg", tmp_path / "b.svg"
    for file in (first, second):
        run_cli(f"{FLAT} --method ccd --plot {file}")
    assert first.read_bytes() == second.read_bytes()


def test_solve_plot_writes_a_png(run_cli, tmp_path):
    run_cli(f"{FLAT} --method ccd --plot {tmp_path}/arm.PNG")
    assert (tmp_path / "arm.PNG").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ARMS)
def test_solve_plot_draws_links_from_base_to_tip(name):
    model = load_model(name)
    home = model.chain_pose("home")
    line, joints = arm_polyline(model, home)
    assert line[0].tolist() == [0, 0, 0]
    np.testing.assert_allclose(line[-1], model.chain.forward(home)[:3, 3], atol=1e-12)
    assert len(joints) == model.chain.dof


def test_solve_command_and_python_find_the_same_joints(run_cli):
    found = run_cli(f"{POINT} --json").json["q_rad"]
    assert found == ikservo.solve("so101", (0.25, 0.05, 0.15)).q.tolist()


@pytest.mark.parametrize("compiled", [True, False])
def test_solve_compare_says_which_methods_are_compiled(run_cli, monkeypatch, compiled):
    monkeypatch.setattr("ikservo.cli.solve_reports.is_compiled", lambda: compiled)
    methods = run_cli(f"{POINT} --compare --json").json["methods"]
    assert [m["method"] for m in methods if m["compiled"]] == ["bounded"] * compiled
    assert ("`bounded` is compiled" in run_cli(f"{POINT} --compare").err) == compiled


def test_joint_limit_error_of_solve_does_not_mention_degrees(run_cli):
    result = run_cli("joints elbow_flex=200 --arm so101 --port sim")
    assert (result.code, "Did you mean" in result.err) == (8, False)
