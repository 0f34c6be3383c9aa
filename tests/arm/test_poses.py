"""Taught poses are stored for one arm, found by name, and never overwrite another."""

import math

import pytest

import ikservo
from ikservo.errors import BadValueError, FileFormatError, UnknownNameError
from ikservo.files.writing import FileWriteError
from ikservo.planning.poses import PoseLibrary, known_pose_names, pose_path
from tests.arm.simulated import line_of


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def model():
    return ikservo.load_model("open_manipulator_x")


@pytest.fixture
def poses(model):
    return PoseLibrary(model, "58FA083")


CUP = {"joint1": 0.1, "joint2": -0.2, "joint3": 0.3, "joint4": 0.0, "gripper": 0.012}


def test_saved_pose_is_read_back_unchanged(poses):
    poses.save("cup", CUP)
    assert poses.get_pose("cup") == pytest.approx(CUP, abs=1e-5)


def test_pose_file_has_degrees_for_turns_and_metres_for_slides(poses):
    text = poses.save("cup", CUP).read_text()
    assert "joint1 = 5.7296" in text
    assert "gripper = 0.012" in text


def test_saved_poses_include_poses_of_arm_file(poses, model):
    assert poses.get_pose("home") == model.poses["home"]
    assert set(poses.all_poses()) == {"rest", "home", "zero"}


def test_saving_second_pose_keeps_first_pose(poses):
    poses.save("cup", CUP)
    poses.save("plate", {**CUP, "joint1": 0.5})
    assert set(poses.user_poses()) == {"cup", "plate"}


def test_pose_saved_again_replaces_old_pose(poses):
    poses.save("cup", CUP)
    poses.save("cup", {**CUP, "joint1": 0.5})
    assert poses.get_pose("cup")["joint1"] == pytest.approx(0.5, abs=1e-5)


def test_poses_are_stored_per_adapter(poses, model):
    poses.save("cup", CUP)
    assert PoseLibrary(model, "OTHER").user_poses() == {}


def test_unknown_pose_suggests_the_closest_name(poses):
    poses.save("cup", CUP)
    with pytest.raises(UnknownNameError, match="Did you mean cup"):
        poses.get_pose("cpu")


@pytest.mark.parametrize(
    "name", ["", "a b", "../rest", "a/b", "ü", "x" * 65, "cup\n", "cup.toml", "\0"]
)
def test_invalid_pose_name_is_refused(poses, name):
    with pytest.raises(BadValueError, match="name of the pose"):
        poses.save(name, CUP)
    assert not poses.path.exists()


@pytest.mark.parametrize("name", ["rest", "home", "zero"])
def test_pose_of_arm_file_cannot_be_replaced(poses, name):
    with pytest.raises(BadValueError, match="pose of the arm file"):
        poses.save(name, CUP)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("format = 2\narm = 'open_manipulator_x'\n", "format"),
        ("format = 1\narm = 'so101'\n", 'is "so101"'),
        ("format = 1\narm = 'open_manipulator_x'\nspeed = 1\n", "speed"),
        ("format = 1\narm = 'open_manipulator_x'\n[poses.cup]\ndeg = {joint1 = 1.0}\n", "missing"),
        ("format = 1\narm = 'open_manipulator_x'\n[poses.cup]\ndeg = {jont1 = 1.0}\n", "jont1"),
        ("format = 1\narm = 'open_manipulator_x'\n[poses.cup]\ndeg = {joint1 = nan}\n", "joint1"),
        ("format = 1\narm = 'open_manipulator_x'\n[poses.'a b']\ndeg = {}\n", "a b"),
        ("format = 1\narm = ", "is not TOML"),
        ("", "empty"),
    ],
)
def test_damaged_pose_file_is_reported_and_kept(poses, text, found):
    poses.path.parent.mkdir(parents=True)
    poses.path.write_text(text)
    with pytest.raises(FileFormatError, match=found):
        poses.get_pose("cup")
    with pytest.raises(FileFormatError):
        poses.save("cup", CUP)
    assert poses.path.read_text() == text


def test_damaged_pose_file_leaves_arm_file_poses_usable(poses, model):
    poses.path.parent.mkdir(parents=True)
    poses.path.write_text("spoiled")
    assert poses.get_pose("rest") == model.poses["rest"]


def test_failed_pose_write_raises_file_write_error(poses, monkeypatch):
    poses.save("cup", CUP)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(FileWriteError, match="No space left"):
        poses.save("plate", CUP)
    monkeypatch.undo()


def test_shell_completion_offers_poses_of_every_adapter(poses, model):
    poses.save("cup", CUP)
    PoseLibrary(model, "").save("plate", CUP)
    assert known_pose_names(model) == ["cup", "home", "plate", "rest", "zero"]


def test_pose_file_is_named_by_arm_and_adapter(home):
    assert pose_path("so101", "58FA083") == home / "poses" / "so101-58FA083.toml"


def test_teach_saves_measured_joints_of_limp_arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        positions = arm.teach("here")
        assert arm.poses.get_pose("here") == pytest.approx(positions, abs=1e-5)
        assert positions["elbow_flex"] == pytest.approx(math.radians(45), abs=0.02)
        assert not any(state.torque for state in arm.where().joints)


def test_teach_switches_torque_off_for_hand_guiding():
    with ikservo.open_arm("so101", port="sim:?pose=rest") as arm:
        arm.hold()
        seen = []

        def carry():
            seen.append(any(state.torque for state in arm.where().joints))
            line_of(arm).world.place("shoulder_pan", 0.7)

        arm.teach("carried", carry, hold=True)
        assert seen == [False]
        assert arm.poses.get_pose("carried")["shoulder_pan"] == pytest.approx(0.7, abs=0.02)
        assert all(state.torque for state in arm.where().joints)


def test_teach_refuses_invalid_name_before_torque_goes_off():
    with ikservo.open_arm("so101", port="sim") as arm:
        with pytest.raises(BadValueError):
            arm.teach("../x", lambda: pytest.fail("the person was asked"))
        assert not any(state.torque for state in arm.where().joints)


def test_taught_pose_can_be_reached():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.teach("here")
        line_of(arm).world.place("gripper", 0.4)
        assert arm.pose("here").reached
        assert arm.where().joints[-1].position_rad == pytest.approx(math.radians(30), abs=0.02)
