"""Valid values of ``[gripper]`` in an arm file, and their meaning."""

import shutil

import pytest

from ikservo.errors import FileFormatError
from ikservo.model import load_model
from tests.oracle import CONFIGS


def with_gripper(arm_path, arm_text, table):
    arm_path.write_text(f"{arm_text}\n[gripper]\n{table}\n")
    return arm_path


def test_gripper_closes_towards_joint_limit_nearer_to_zero(arm_path):
    gripper = load_model(arm_path).gripper
    assert (gripper.joint, gripper.closed, gripper.open) == ("gripper", 0.0, 0.02)


def test_closes_to_key_sets_closing_limit_of_gripper(arm_path, arm_text):
    gripper = load_model(with_gripper(arm_path, arm_text, 'closes_to = "upper"')).gripper
    assert (gripper.closed, gripper.open) == (0.02, 0.0)


def test_gripper_width_is_interpolated_between_pairs(arm_path, arm_text):
    table = "width_m_by_m = [[0.0, 0.01], [0.01, 0.03], [0.02, 0.07]]"
    gripper = load_model(with_gripper(arm_path, arm_text, table)).gripper
    assert gripper.width_m(0.015) == pytest.approx(0.05)
    assert gripper.position(0.02) == pytest.approx(0.005)
    assert gripper.range_m() == pytest.approx((0.01, 0.07))


def test_gripper_width_may_decrease_with_joint_position(arm_path, arm_text):
    table = "width_m_by_m = [[0.0, 0.05], [0.02, 0.01]]"
    gripper = load_model(with_gripper(arm_path, arm_text, table)).gripper
    assert gripper.position(0.03) == pytest.approx(0.01)


def test_gripper_without_width_table_has_no_width(arm_path):
    gripper = load_model(arm_path).gripper
    assert (gripper.width_m(0.01), gripper.range_m()) == (None, None)


@pytest.mark.parametrize(
    ("table", "where"),
    [
        ('closes_to = "left"', "gripper.closes_to"),
        ("width_m_by_deg = [[0.0, 0.01], [10.0, 0.03]]", "gripper.width_m_by_deg"),
        ("width_m_by_m = [[0.0, 0.01]]", "gripper.width_m_by_m"),
        ("width_m_by_m = [[0.0, 0.01], [0.0, 0.02]]", "gripper.width_m_by_m"),
        ("width_m_by_m = [[0.0, 0.01], [0.01, 0.03], [0.02, 0.02]]", "gripper.width_m_by_m"),
        ("width_m_by_m = [[0.0, -0.01], [0.01, 0.03]]", "gripper.width_m_by_m"),
        ("width_m_by_m = [[0.0, nan], [0.01, 0.03]]", "gripper.width_m_by_m"),
        ("width_m_by_m = 0.03", "gripper.width_m_by_m"),
        ("width = 0.03", "gripper.width"),
    ],
)
def test_gripper_table_error_names_its_key(arm_path, arm_text, table, where):
    with pytest.raises(FileFormatError) as caught:
        load_model(with_gripper(arm_path, arm_text, table))
    assert caught.value.where.startswith(where)


def test_gripper_of_continuous_joint_is_refused_with_hint(tmp_path):
    shutil.copytree(CONFIGS / "so101", tmp_path / "arm")
    urdf = tmp_path / "arm" / "arm.urdf"
    text = urdf.read_text().replace('"gripper" type="revolute"', '"gripper" type="continuous"')
    urdf.write_text(text)
    with pytest.raises(FileFormatError, match="its jaws have no ends") as caught:
        load_model(tmp_path / "arm")
    assert "limits_deg" in caught.value.hint


def test_servo_on_mimic_joint_is_refused(arm_path, arm_text):
    text = arm_text.replace('name = "gripper"', 'name = "other_finger"')
    arm_path.write_text(text.replace("{ gripper =", "{ other_finger ="))
    with pytest.raises(FileFormatError, match=r'"other_finger" follows "gripper"'):
        load_model(arm_path)
