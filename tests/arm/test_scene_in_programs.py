"""Obstacles come and go while a program runs; a held object is a part of the arm."""

import threading

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError, CollisionError, FileFormatError, UnknownNameError
from ikservo.planning import preflight_planner
from tests.arm.simulated import call_before, context_of, motion_runner, registers
from tests.arm.test_ways_around import LEFT, RIGHT


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.move_to(LEFT)
        yield arm


def test_scene_object_blocks_paths_until_removed(arm):
    before = arm.plan_to(RIGHT)
    arm.scene.add("box", "the post", centre_m=(0.22, 0.0, 0.12), size_m=[0.15, 0.04, 0.25])
    assert arm.scene.names == ("the post",)
    with pytest.raises(CollisionError, match="the post"):
        arm.move_to(RIGHT, straight=True)
    with pytest.raises(CollisionError, match="the post"):
        arm.execute(before)
    arm.scene.remove("the post")
    assert arm.scene.names == ()
    assert arm.move_to(RIGHT, straight=True).reached


@pytest.mark.full
def test_held_object_is_collision_checked_until_gripper_opens(arm):
    tip_m = arm.where().tip_m
    arm.scene.add("sphere", "the ball", centre_m=tip_m + np.array([0.0, 0.0, 0.01]), radius_m=0.03)
    free_m = arm.clearance_m(arm.where().positions)
    assert free_m < 0.0  # it stands in the jaws
    arm.scene.attach("the ball")
    assert arm.scene.names == ()
    assert arm.scene.held == ("the ball",)
    arm.scene.add("box", "the wall", centre_m=RIGHT, size_m=(0.02, 0.02, 0.3))
    beside = np.array(RIGHT) + np.array([0.0, 0.034, 0.0])
    arm.move_to(beside + np.array([0.0, 0.03, 0.0]), straight=True)
    with pytest.raises(CollisionError, match="the ball would touch the wall"):
        arm.move_to(beside, straight=True)
    centre_m = context_of(arm).planner.tip(np.array(list(arm.where().positions.values())))
    arm.gripper("open")
    assert arm.scene.held == ()
    assert arm.scene.names == ("the wall", "the ball")
    placed = next(each for each in arm.scene.things if each.name == "the ball")
    assert np.linalg.norm(placed.row[9:12] - centre_m) < 0.02


@pytest.mark.full
def test_attached_object_keeps_its_size_and_place(arm):
    centre_m, size_m = arm.where().tip_m, (0.03, 0.05, 0.08)
    arm.scene.add("box", "the block", centre_m=centre_m, size_m=size_m, rpy_deg=(10, 20, 30))
    (stands,) = arm.scene.things
    arm.scene.attach("the block")
    arm.scene.release("the block")
    (again,) = arm.scene.things
    np.testing.assert_allclose(again.row, stands.row, atol=1e-12)


def test_attached_objects_weigh_payload_of_arm_file_together(arm):
    def weight_kg():
        return context_of(arm).collision.sag.masses[:, 0].sum()

    empty_kg, payload_kg = weight_kg(), arm.model.payload_kg
    for name in ("one", "two", "three"):
        arm.scene.add("sphere", name, centre_m=arm.where().tip_m, radius_m=0.01)
        arm.scene.attach(name)
        assert weight_kg() == pytest.approx(empty_kg + payload_kg)


def test_invalid_scene_change_is_refused_and_changes_nothing(arm, tmp_path):
    arm.scene.add("cylinder", "the can", centre_m=(0.0, 0.4, 0.1), radius_m=0.03, height_m=0.2)
    with pytest.raises(UnknownNameError, match="sphere"):
        arm.scene.add("ball", "x", radius_m=0.1)
    with pytest.raises(FileFormatError, match="radius_m"):
        arm.scene.add("sphere", "x", centre_m=(0, 0, 1), radius_m=-1.0)
    with pytest.raises(BadValueError, match="the can"):
        arm.scene.add("sphere", "the can", centre_m=(0, 0, 1), radius_m=0.1)
    with pytest.raises(UnknownNameError, match="the can"):
        arm.scene.remove("the cam")
    with pytest.raises(UnknownNameError):
        arm.scene.release("the can")
    (tmp_path / "scene.toml").write_text(
        '[[half_space]]\nname = "the wall"\npoint_m = [-0.5, 0.0, 0.0]\nnormal = [1, 0, 0]\n'
    )
    arm.scene.load(tmp_path / "scene.toml")
    with pytest.raises(BadValueError, match="at most 1 m"):
        arm.scene.attach("the wall")
    assert arm.scene.names == ("the can", "the wall")


@pytest.mark.parametrize(
    ("kind", "sizes"),
    [
        ("sphere", {"radius_m": 0.52}),
        ("cylinder", {"radius_m": 0.52, "height_m": 0.1}),
        ("cylinder", {"radius_m": 0.01, "height_m": 1.04}),
        ("box", {"size_m": (0.01, 1.04, 0.01)}),
    ],
)
def test_attach_refuses_object_above_1_m_of_any_shape(arm, kind, sizes):
    arm.scene.add(kind, "the thing", centre_m=(0.3, 0.0, 2.0), **sizes)
    with pytest.raises(BadValueError, match="at most 1 m"):
        arm.scene.attach("the thing")
    assert arm.scene.names == ("the thing",)


WALL = {"centre_m": (0.2, 0.0, 0.1), "size_m": (0.3, 0.02, 0.2)}


def in_another_thread(action):
    """Run a function in a thread of its own, and wait for it."""
    thread = threading.Thread(target=action)
    thread.start()
    thread.join()


@pytest.mark.full
def test_plan_uses_scene_snapshot_while_other_thread_edits_it(arm):
    free, done = arm.plan_to(RIGHT, straight=True), threading.Event()
    ball = {"centre_m": arm.where().tip_m, "radius_m": 0.02}

    def change():
        while not done.is_set():
            arm.scene.add("sphere", "the ball", **ball)
            arm.scene.attach("the ball")
            arm.scene.add("box", "the wall", **WALL)
            arm.scene.remove("the wall")
            arm.scene.remove("the ball")

    changing, ends = threading.Thread(target=change), set()
    changing.start()
    try:
        for _ in range(15):
            try:
                plan = arm.plan_to(RIGHT, straight=True)
            except CollisionError as error:
                ends.add(error.pair[1])
            else:
                np.testing.assert_allclose(plan.tip_m, RIGHT, atol=1e-4)
                ends.add("")
    finally:
        done.set()
        changing.join()
    assert "" in ends
    assert ends <= {"", "the wall", "the ball", "the table"}
    assert arm.plan_to(RIGHT, straight=True).clearance_m == free.clearance_m


def test_object_added_during_planning_makes_motion_refused(monkeypatch, arm):
    before = registers(arm, "goal_position")

    def build():
        in_another_thread(lambda: arm.scene.add("box", "the wall", **WALL))

    call_before(preflight_planner, "plan_motion", monkeypatch, build)
    with pytest.raises(CollisionError, match="the wall"):
        arm.move_to(RIGHT, straight=True)
    assert registers(arm, "goal_position") == before


@pytest.mark.full
def test_scene_change_waits_for_end_of_jaw_motion(monkeypatch, arm):
    threads, centre_m = [], arm.where().tip_m

    def build():
        add = lambda: arm.scene.add("sphere", "it", centre_m=centre_m, radius_m=0.03)  # noqa: E731
        threads.append(threading.Thread(target=add))
        threads[0].start()
        threads[0].join(timeout=0.1)

    call_before(motion_runner(arm), "return_within_limits", monkeypatch, build)
    seen = []
    arm.gripper("open", on_progress=lambda _: seen.append(arm.scene.names))
    threads[0].join()
    assert set(seen) == {()}
    assert arm.scene.names == ("it",)


@pytest.mark.full
def test_held_object_on_table_is_lifted_around_obstacles(arm):
    arm.move_to((0.2, 0.12, 0.06))
    tip_m, height_m = arm.where().tip_m, 2.0 * (arm.where().tip_m[2] + 0.002)
    standing = {"centre_m": tip_m, "size_m": (0.02, 0.02, height_m)}
    arm.scene.add("box", "the block", **standing)  # 2 mm into the table, as a cup looks to be
    arm.scene.attach("the block")
    with pytest.raises(CollisionError, match="the block would touch the table"):
        arm.plan_line(tip_m - np.array([0.0, 0.0, 0.01]))
    arm.scene.add("box", "the wall", centre_m=(0.24, 0.0, 0.04), size_m=(0.16, 0.02, 0.08))
    plan = arm.plan_to((0.2, -0.12, 0.1))
    assert plan.around
    context = context_of(arm)
    bodies = context.index.body_joints(plan.sample(0.01).positions)
    gaps_m = context.collision.distances(bodies)
    at = context.collision.pairs.index(("the block", "the table"))
    free = int((gaps_m[:, at] > 0.0).argmax())
    assert gaps_m[:, at].min() >= gaps_m[0, at] - 5e-4
    assert 0 < free < len(gaps_m) // 2
    assert gaps_m[free:, at].min() > -5e-4
    others = [i for i, pair in enumerate(context.collision.pairs) if "the wall" in pair]
    assert gaps_m[:, others].min() > 0.0
    assert arm.execute(plan).reached
