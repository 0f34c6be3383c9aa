"""``ikservo scene`` shows the obstacles of a scene file, and the poses that touch them."""

import pytest

SCENE = """
[[box]]
name = "the shelf"
centre_m = [0.5, 0.0, 0.2]
size_m = [0.2, 0.4, 0.02]
[[cylinder]]
name = "the can"
centre_m = [{x}, 0.0, 0.06]
radius_m = 0.03
height_m = 0.12
"""


@pytest.fixture
def scene(tmp_path):
    def write(x):
        path = tmp_path / "scene.toml"
        path.write_text(SCENE.format(x=x))
        return path

    return write


def test_scene_show_lists_objects_with_positions_and_sizes(run_cli, scene):
    shown = run_cli(f"scene show {scene(0.1)} --json").json
    assert [thing["name"] for thing in shown["things"]] == ["the shelf", "the can"]
    assert shown["things"][0]["low_m"] == pytest.approx([0.4, -0.2, 0.19])
    assert "0.070, -0.030, 0.000" in run_cli(f"scene show {scene(0.1)}").out


def test_scene_check_names_poses_that_touch_an_object(run_cli, scene):
    found = run_cli(f"scene check {scene(0.1)} --arm so101")
    assert found.code == 1
    assert "home: upper_arm touches the can" in found.out
    touched = run_cli(f"scene check {scene(0.1)} --arm so101 --json").json["touched"]
    assert {each["thing"] for each in touched} == {"the can"}
    assert all(each["depth_m"] > 0.0 for each in touched)
    free = run_cli(f"scene check {scene(-0.6)} --arm so101")
    assert (free.code, free.out) == (0, "No pose of the arm touches anything in the scene.\n")


def test_scene_command_refuses_unknown_action_and_missing_file(run_cli, scene, tmp_path):
    assert run_cli(f"scene draw {scene(0.1)}").code == 2
    assert run_cli(f"scene show {tmp_path / 'none.toml'}").code == 2


def test_scene_check_reports_that_second_arm_is_not_checked(run_cli, scene):
    path = scene(-0.6)
    path.write_text(path.read_text() + '[[arm]]\nname = "koch"\nat_m = [0.45, 0, 0]\n')
    (arm,) = run_cli(f"scene show {path} --json").json["arms"]
    assert (arm["name"], arm["at_m"], arm["rpy_deg"]) == ("koch", [0.45, 0, 0], [0, 0, 0])
    assert "koch" in run_cli(f"scene show {path}").out
    checked = run_cli(f"scene check {path} --arm so101")
    assert (checked.code, "Not checked: koch" in checked.err) == (0, True)
    assert run_cli(f"scene check {path} --arm so101 --json").json["unchecked"] == ["koch"]
