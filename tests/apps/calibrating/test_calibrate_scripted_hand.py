"""``calibrate --yes`` succeeds with the simulator's scripted hands on every arm."""

import math

import pytest

import servosim
from tests.calibration.mounted_arms import load_model
from tests.oracle import ARMS, CONFIGS

EVERY_ARM = [
    pytest.param(arm, marks=() if arm == "so101" else pytest.mark.campaign) for arm in ARMS
]
NEARLY_A_TURN_DEG = 350.0


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))


@pytest.mark.full
@pytest.mark.parametrize("arm", EVERY_ARM)
def test_simulated_hand_calibrates_every_shipped_arm(run_cli, arm):
    done = run_cli(f"calibrate {arm} --port sim:?hand=calibrate --yes --json")
    assert done.code == 0, done.err
    model = load_model(arm)
    for joint in done.json["joints"]:
        known = model.joint(joint["name"])
        assert joint["sign"] == known.joint_map.sign
        ends_deg = [math.degrees(end.value) for end in (known.limits.lower, known.limits.upper)]
        if known.joint_map.unit == "m":
            assert joint["swept"] == "by hand", joint["name"]
        elif ends_deg[1] - ends_deg[0] > NEARLY_A_TURN_DEG:
            assert f"{joint['name']} turns freely" in " ".join(done.json["findings"])
        else:
            found = [joint["lower_deg"], joint["upper_deg"]]
            assert found == pytest.approx(ends_deg, abs=1.0), joint["name"]


@pytest.mark.full
@pytest.mark.parametrize("pose", ["rest", "home"])
def test_simulated_arm_is_calibrated_without_a_person(run_cli, pose):
    done = run_cli(f"calibrate planar2 --port sim --pose {pose}")
    assert done.code == 0, done.err
    assert "A simulated hand moves the simulated joints" in done.err
    assert f'In the pose "{pose}", the tip is' in done.err


@pytest.mark.campaign
def test_arm_with_reversed_servos_is_calibrated(run_cli, monkeypatch, tmp_path):
    opened = servosim.open_port

    def open_port(url):
        text = (CONFIGS / "planar2" / "arm.toml").read_text().replace("sign = 1", "sign = -1")
        (tmp_path / "arm.toml").write_text(text)
        (tmp_path / "arm.urdf").write_text((CONFIGS / "planar2" / "arm.urdf").read_text())
        return opened(f"sim:{tmp_path / 'arm.toml'}?hand=calibrate")

    monkeypatch.setattr("servosim.open_port", open_port)
    done = run_cli("calibrate planar2 --port sim --yes --json")
    assert done.code == 0, done.err
    assert [joint["sign"] for joint in done.json["joints"]] == [-1, -1]
    assert "joint2: its sign, measured twice, contradicts the arm file." in done.json["findings"]
