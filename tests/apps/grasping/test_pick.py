"""Picks that are refused before anything moves, grasps that find nothing, jaws and blocks."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.apps.cameras.board_detection import Intrinsics
from ikservo.apps.cameras.camera_model import CameraModel
from ikservo.apps.grasping import jaws, pick_and_place
from ikservo.apps.grasping.jaws import find_jaws
from ikservo.apps.grasping.pick_and_place import Pick, Place, pick_box
from ikservo.errors import BadValueError, IkservoError, InputError, RefusedError, UnreachableError
from ikservo.model import load_model
from ikservo.model.scene_file import make_shape
from servosim.camera import look_at
from tests.arm.simulated import line_of

CUBE = (0.035, 0.035, 0.035)


@pytest.fixture
def so101():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        yield arm


def refused(arm, kind, text, *given, **options):
    """Check that a pick is refused, and that no servo has its torque on or another goal."""
    servos = line_of(arm).servos.values()
    before = [servo.read("goal_position") for servo in servos]
    with pytest.raises(kind, match=text):
        arm.pick(*given, **options)
    assert [servo.read("goal_position") for servo in servos] == before
    assert not any(servo.read("torque_enable") for servo in servos)


def test_pick_refuses_object_wider_than_gripper(so101):
    size_m = (0.09, 0.1, 0.03)
    refused(
        so101,
        RefusedError,
        "90 by 100 mm wide, but the jaws hold only 0 to 7",
        (0.24, 0.0, 0.02),
        size_m=size_m,
    )


@pytest.mark.parametrize(("name", "wide_mm", "least_mm"), [("wx250s", 31, 32), ("vx300s", 35, 44)])
def test_pick_refuses_object_narrower_than_closed_gripper(name, wide_mm, least_mm):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        refused(
            arm,
            RefusedError,
            f"20 by {wide_mm} mm wide, but the jaws hold only {least_mm} to ",
            (0.3, 0.0, 0.02),
            size_m=(0.02, wide_mm / 1000.0, 0.04),
        )


def test_pick_refuses_object_too_narrow_and_too_wide():
    with ikservo.open_arm("wx250s", port="sim:?pose=home") as arm:
        text = "20 by 90 mm wide, but the jaws hold only 32 to 72 mm"
        refused(arm, RefusedError, text, (0.3, 0.0, 0.02), size_m=(0.09, 0.02, 0.04))


def test_pick_grips_object_across_side_on_which_jaws_close():
    with ikservo.open_arm("vx300s", port="sim:?pose=home") as arm:
        motion = Pick((0.3, 0.0, 0.025), size_m=(0.06, 0.035, 0.05), yaw_rad=0.4)
        steps, _ = motion.plan(arm.context, arm.where().positions_rad)
        R = arm.context.planner.tip_pose(steps[2].goal)[:3, :3]
        x, y, _ = R @ find_jaws(arm.model).axis
        assert abs(math.sin(math.atan2(y, x) - 0.4)) < math.sin(math.radians(15.0))


def test_object_of_unknown_size_is_as_wide_as_jaws_hold():
    with ikservo.open_arm("vx300s", port="sim:?pose=home") as arm:
        Pick((0.3, 0.0, 0.025)).plan(arm.context, arm.where().positions_rad)


def test_pick_refuses_point_below_the_table(so101):
    refused(so101, RefusedError, "below the table", (0.24, 0.0, -0.01), size_m=CUBE)


def test_pick_refuses_point_out_of_reach(so101):
    refused(so101, UnreachableError, "cannot be reached", (0.8, 0.0, 0.02), size_m=CUBE)


def test_pick_refuses_object_too_flat_for_fingers_above_table(so101):
    flat = (0.03, 0.03, 0.002)
    refused(
        so101, RefusedError, "cannot grip or put down anything", (0.24, 0.0, 0.001), size_m=flat
    )


def test_pick_refuses_object_under_a_shelf(so101, monkeypatch):
    monkeypatch.setattr("ikservo.apps.grasping.pick_and_place._SEARCH_S", 5.0)  # enough to be sure
    so101.scene.add("box", "the shelf", center_m=(0.25, 0.0, 0.1), size_m=(0.2, 0.4, 0.02))
    refused(so101, RefusedError, "cannot grip .* at", (0.25, 0.0, 0.0175), size_m=CUBE)


def test_place_refuses_to_press_held_object_into_table(so101):
    so101.grip.T_thing_tip, so101.grip.height_m = np.eye(4), 0.035
    so101.grip.jaws_at = so101.where()["gripper"].position_rad
    with pytest.raises(RefusedError, match="12 mm below the table"):
        so101.place((0.2, 0.1, 0.005))
    assert not any(servo.read("torque_enable") for servo in line_of(so101).servos.values())


@pytest.mark.parametrize("thing", [
    make_shape("sphere", "the ball", {"center_m": (0.24, 0.0, 0.02), "radius_m": 0.02}),
    make_shape("cylinder", "the can", {"center_m": (0.24, 0.0, 0.02), "radius_m": 0.02,
                                       "height_m": 0.04}),
    make_shape("box", "the ramp", {"center_m": (0.24, 0.0, 0.02), "size_m": CUBE,
                                   "rpy_deg": (20.0, 0.0, 0.0)}),
], ids=["ball", "cylinder", "tilted box"])  # fmt: skip
def test_pick_refuses_objects_other_than_upright_boxes(thing):
    with pytest.raises(RefusedError, match="is not an upright box"):
        pick_box(thing)


@pytest.mark.parametrize("yaw_rad", [math.nan, math.inf, "x", None])
def test_pick_refuses_yaw_that_is_not_finite(yaw_rad):
    with pytest.raises(BadValueError):
        Pick((0.2, 0.0, 0.02), yaw_rad=yaw_rad)


def test_pick_refuses_size_that_is_not_positive():
    with pytest.raises(BadValueError, match="three lengths above 0"):
        Pick((0.2, 0.0, 0.02), size_m=(0.03, 0.0, 0.03))


def test_arm_without_gripper_cannot_pick():
    with pytest.raises(IkservoError, match="no gripper"):
        find_jaws(load_model("planar3"))


def test_gripper_without_space_between_jaws_is_refused(monkeypatch):
    thick = [replace(each, radius_m=0.3) for each in jaws.capsules_of(load_model("so101"))]
    monkeypatch.setattr(jaws, "capsules_of", lambda _: thick)
    with pytest.raises(IkservoError, match="width of the gripper of so101 is not known"):
        find_jaws(load_model("so101"))


def test_empty_pick_is_reported_and_opens_jaws(so101):
    with pytest.raises(RefusedError, match="found nothing at"):
        so101.pick((0.24, 0.05, 0.0175), size_m=CUBE)
    assert so101.where().tip_m[2] > 0.06
    assert so101.where()["gripper"].position_rad > 1.6
    with pytest.raises(RefusedError, match="holds nothing"):
        so101.place((0.24, -0.05, 0.0175))


def test_carried_cube_hardly_slips_in_jaws():
    pytest.importorskip("mujoco")
    with ikservo.open_arm("koch", "sim:?pose=home&physics=1&cubes=red@0.16,0.04") as arm:
        world = line_of(arm).world

        def cube_at_tip_m():
            T = world.tip.pose([joint.position for joint in world.joints])
            return (np.linalg.inv(T) @ world.cube_poses()[0])[:3, 3]

        arm.pick((0.16, 0.04, 0.0175), size_m=CUBE)
        held_m = cube_at_tip_m()
        for pan_rad in (-0.6, 0.6):
            arm.move_joints({"shoulder_pan": pan_rad}, speed="slow")
        # It slides by 0.5 mm; by friction that creeps, by 2.6 mm.
        assert abs(cube_at_tip_m()[2] - held_m[2]) < 0.001


def test_pick_plan_approaches_from_above_without_moving_arm(so101):
    start = so101.where().positions_rad
    steps, whole = Pick((0.24, 0.05, 0.0175), size_m=CUBE).plan(so101.context, start)
    names = [getattr(step, "motion", step).kind for step in steps]
    line, jaws = "move_line", "move_gripper"
    assert names == [jaws, "move_to", line, jaws, line, jaws]
    above, grasp = (np.array(steps[i].motion.position_m) for i in (1, 2))
    np.testing.assert_allclose(above - grasp, (0.0, 0.0, 0.08), atol=1e-9)
    np.testing.assert_allclose(whole.start, start)
    np.testing.assert_allclose(whole.trajectory.state(whole.duration_s).position, whole.goal)
    assert not any(servo.read("torque_enable") for servo in line_of(so101).servos.values())


@pytest.mark.parametrize(("height_m", "most_m"), [(0.004, 0.0), (0.035, 0.0135), (0.1, 0.015)])
def test_pick_tries_grip_heights_up_to_highest_secure_one(so101, monkeypatch, height_m, most_m):
    tried = []
    monkeypatch.setattr(
        pick_and_place._GraspPlanner, "plan", lambda _, middle, raises, *rest: tried.extend(raises)
    )
    size_m, start = (0.03, 0.03, height_m), so101.where().positions_rad
    Pick((0.24, 0.05, 0.0175), size_m=size_m).plan(so101.context, start)
    assert tried == sorted(set(tried))
    assert tried[-1] == pytest.approx(most_m)


def test_fingers_that_reach_beyond_tip_grip_higher(monkeypatch):
    tried = []
    monkeypatch.setattr(
        pick_and_place._GraspPlanner, "plan", lambda _, middle, raises, *rest: tried.extend(raises)
    )
    with ikservo.open_arm("wx250s", port="sim:?pose=home") as arm:
        Pick((0.24, 0.05, 0.0175), size_m=CUBE).plan(arm.context, arm.where().positions_rad)
    # The fingers end 10 mm beyond the tip; 8 mm of them are on the cube.
    assert tried[-1] == pytest.approx(0.0175 + 0.010 - 0.008, abs=1e-4)


@pytest.mark.parametrize(
    ("name", "x_m", "y_m", "most_m"), [("koch", 0.16, 0.04, 0.004), ("wx250s", 0.24, 0.05, 0.0135)]
)
def test_planned_grip_height_is_as_low_as_table_allows(name, x_m, y_m, most_m):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        start = arm.where().positions_rad
        steps, _ = Pick((x_m, y_m, 0.0175), size_m=CUBE).plan(arm.context, start)
        assert steps[2].motion.position_m[2] - 0.0175 < most_m


def test_cube_is_between_the_jaws_in_the_planned_grasp(so101):
    middle_m = np.array([0.24, 0.05, 0.0175])
    start = so101.where().positions_rad
    steps, _ = Pick(middle_m, size_m=CUBE, yaw_rad=0.3).plan(so101.context, start)
    planned = so101.plan_to(steps[2].motion.position_m, stance=steps[2].motion.stance)
    T = so101.context.planner.tip_pose(planned.goal)
    along, aside, _ = (middle_m - T[:3, 3]) @ np.column_stack(
        [T[:3, :3] @ find_jaws(so101.model).axis, np.cross(T[:3, 2], T[:3, 0]), T[:3, 2]]
    )
    assert along == pytest.approx(0.0175 + 0.006, abs=0.001)  # the fixed jaw is at the tip
    assert abs(aside) < 0.002


@pytest.mark.parametrize(
    ("name", "most_mm", "beside_mm"),
    [("so101", 76, 23), ("koch", 53, 22), ("omx_f", 97, 0), ("open_manipulator_x", 82, 0)],
)
def test_jaw_opening_is_computed_from_gripper_shapes(name, most_mm, beside_mm):
    jaws = find_jaws(load_model(name))
    assert 1000.0 * jaws.most_m == pytest.approx(most_mm, abs=1.0)
    assert 1000.0 * np.linalg.norm(jaws.at_width(0.047)[1]) == pytest.approx(beside_mm, abs=2.0)


WITH_WIDTHS = ("open_manipulator_x", "px100", "px150", "rx150", "rx200", "wx200", "wx250s",
               "vx250", "vx300s")  # fmt: skip


@pytest.mark.parametrize("name", WITH_WIDTHS)
def test_fingers_of_description_open_as_wide_as_arm_file_says(name):
    model = load_model(name)
    said = find_jaws(model)
    drawn = find_jaws(replace(model, gripper=replace(model.gripper, widths=())))
    # The capsules are up to 2 mm thicker than a finger; a crank differs from its line by 2.4 mm.
    away_m = (drawn.high_m - drawn.low_m) - (said.high_m - said.low_m)
    assert away_m.min() > -0.0075
    assert away_m.max() < 0.002
    np.testing.assert_allclose(np.abs(drawn.axis), (0.0, 1.0, 0.0), atol=1e-9)


def test_pick_and_place_are_program_steps():
    assert Pick((0.2, 0.0, 0.02)).kind == "pick"
    assert str(Place((0.2, 0.0, 0.02))) == "put down at (0.200, 0.000, 0.020) m"


def picture_of_block(model, corners_m, colour):
    """Return a picture of a convex body on a grey table."""
    cv2 = pytest.importorskip("cv2")
    width, height = model.lens.size
    picture = np.full((height, width, 3), 130, np.uint8)
    hull = cv2.convexHull(model.project(corners_m)[0].astype(np.float32))
    cv2.fillConvexPoly(picture, np.round(hull).astype(np.int32), colour)
    return picture


@pytest.fixture
def camera():
    lens = Intrinsics(
        np.array([[800.0, 0, 480], [0, 800, 360], [0, 0, 1]]), np.zeros(5), (960, 720)
    )
    return CameraModel(lens, look_at(np.array([0.6, 0.25, 0.4]), np.array([0.2, 0.0, 0.0])))


def box_corners(at_m, size_m, yaw_rad):
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return (corners * size_m) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + (*at_m, 0.0)


def test_camera_finds_position_size_and_yaw_of_coloured_block(camera):
    pytest.importorskip("cv2")
    from ikservo.apps.cameras.blocks import find_block_at, find_blocks

    corners_m = box_corners((0.22, 0.03), (0.06, 0.03, 0.03), 1.2)
    picture = picture_of_block(camera, corners_m, (200, 40, 30))
    (block,) = find_blocks(camera, picture, 0.0)
    assert block.name == "the blue block"
    np.testing.assert_allclose(block.row[9:12], (0.22, 0.03, 0.015), atol=0.002)
    np.testing.assert_allclose(np.sort(2.0 * block.half_size_m), (0.03, 0.03, 0.06), atol=0.003)
    motion = Pick(block.row[9:12], size_m=2.0 * block.half_size_m)
    assert motion.size_m == tuple(2.0 * block.half_size_m)
    u, v = camera.project(np.array([0.22, 0.03, 0.015]))[0]
    assert find_block_at(camera, picture, 0.0, u, v).name == block.name
    with pytest.raises(InputError, match="shows no coloured block"):
        find_block_at(camera, picture, 0.0, 30.0, 30.0)


def test_pick_command_reports_that_nothing_was_found(run_cli):
    done = run_cli("pick 0.24 0.05 30mm --arm so101 --port sim:?pose=home")
    assert done.code == 8, done
    assert "found nothing" in done.err


def test_pick_command_needs_a_pixel_or_a_point(run_cli):
    done = run_cli("pick 1 2 3 4 --arm so101 --port sim")
    assert done.code == 2
    assert "neither a pixel nor a point" in done.err


def test_pick_command_with_pixel_needs_calibrated_camera(run_cli):
    done = run_cli("pick 480 360 --arm so101 --port sim")
    assert "no calibrated camera" in done.err
