"""An arm of any servo model reaches its target, even if its motors are unknown."""

import shutil
from pathlib import Path

import pytest

import ikservo
from ikservo.model.servo_torque import find_servo_torque
from ikservo.registers import MODELS

PLANAR = Path(__file__).parents[2] / "configs" / "planar2"
OF_ONE_SERIES_EACH = (
    "STS3235", "HLS3606M", "SCS225", "XC330-T288", "XC430-W150", "2XC430-W250", "XL-320",
)  # fmt: skip


@pytest.fixture
def planar_arm_of(tmp_path):
    """Return a function that describes a planar arm of two servos of a model."""

    def describe(model):
        table, folder = MODELS[model], tmp_path / "arm"
        shutil.copytree(PLANAR, folder)
        text = (folder / "arm.toml").read_text().replace("STS3215", model)
        text = text.replace("feetech_sts", table.family.value)
        middle_tick = 2048 if table.ticks_per_turn == 4096 else 512
        text = text.replace("zero_tick = 2048", f"zero_tick = {middle_tick}")
        (folder / "arm.toml").write_text(text)
        return folder / "arm.toml"

    return describe


@pytest.mark.full
@pytest.mark.sample(2)
@pytest.mark.parametrize("model", OF_ONE_SERIES_EACH)
def test_arm_with_each_servo_series_moves_to_a_point(planar_arm_of, model):
    with ikservo.open_arm(planar_arm_of(model), "sim") as arm:
        report = arm.move_to([0.15, 0.1, 0.05])
        assert report.reached
        assert arm.where().tip_m == pytest.approx([0.15, 0.1, 0.05], abs=0.002)


def test_servo_model_tests_include_models_without_motor_data():
    unknown = [model for model in OF_ONE_SERIES_EACH if find_servo_torque(model, None) is None]
    assert unknown == ["HLS3606M", "SCS225"]
