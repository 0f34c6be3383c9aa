"""Limits of the arm file replace the URDF's, in the model and in the simulator."""

import math

import pytest

import ikservo
from ikservo.errors import FileFormatError
from servosim.arm_file import read_arm_file
from servosim.assembly import make_arm_world
from tests.oracle import CONFIGS

EXAMPLE = CONFIGS.parent / "examples" / "own_arm"


@pytest.fixture
def own_arm(tmp_path):
    """Return a function that writes the example, with a line added to its shoulder."""

    def write(line, kind="revolute"):
        text = (EXAMPLE / "arm.toml").read_text()
        head, found, tail = text.partition('name      = "shoulder"\n')
        assert found
        (tmp_path / "arm.toml").write_text(f"{head}{found}{line}\n{tail}")
        urdf = (EXAMPLE / "arm.urdf").read_text()
        old = '<joint name="shoulder" type="revolute">'
        assert old in urdf
        (tmp_path / "arm.urdf").write_text(urdf.replace(old, old.replace("revolute", kind)))
        return tmp_path / "arm.toml"

    return write


@pytest.mark.parametrize("kind", ["revolute", "continuous"])
def test_arm_file_limits_apply_to_chain_and_simulated_end_stops(own_arm, kind):
    path = own_arm("limits_deg = [-85, 95.5]", kind)
    model = ikservo.load_model(path)
    limits, column = model.joint("shoulder").limits, model.chain.names.index("shoulder")
    expected = math.radians(-85), math.radians(95.5)
    assert (limits.lower.value, limits.upper.value) == pytest.approx(expected)
    assert model.chain.lower_rad[column] == pytest.approx(expected[0])
    assert model.chain.upper_rad[column] == pytest.approx(expected[1])
    (joint,) = [each for each in make_arm_world(read_arm_file(path), "home").joints
                if each.name == "shoulder"]  # fmt: skip
    motor = joint.servos[0].motor
    assert motor.upper_stop_rad - motor.lower_stop_rad == pytest.approx(
        expected[1] - expected[0] + math.radians(4.0)
    )


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("limits_deg = [20, -20]", "lower limit below"),
        ("limits_m = [0, 1]", "limits_deg"),
        ("limits_deg = [0]", "limits_deg"),
        ("limits_deg = [70, 80]", "outside its limits"),
    ],
)
def test_inconsistent_arm_file_limits_are_refused_with_reason(own_arm, line, found):
    with pytest.raises(FileFormatError) as caught:
        ikservo.load_model(own_arm(line))
    assert found in f"{caught.value} {caught.value.hint} {caught.value.where}"
