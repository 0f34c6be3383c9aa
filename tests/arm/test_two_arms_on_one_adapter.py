"""Two arms on one adapter, each opened separately."""

import re
import shutil
from math import degrees, radians
from pathlib import Path

import pytest

import ikservo
from ikservo.arm.other_process import query_state, stop_arm
from ikservo.hardware import port as ports
from servosim.assembly import BenchServo, make_bench_world
from servosim.line import Line
from servosim.port import SimulatedPort

SO101 = Path(__file__).parents[2] / "configs" / "so101"
BAUD = 1_000_000


class Adapter(SimulatedPort):
    """A device with the servos 1 to 12, which one transport at a time can open."""

    abandoned = False

    def __init__(self):
        servos = [BenchServo(servo_id, "STS3215", BAUD) for servo_id in range(1, 13)]
        super().__init__(Line(make_bench_world(servos), BAUD))
        self.is_open, self.opened = False, 0

    def open_transport(self, name, baud_rate):
        if self.is_open:
            raise ikservo.PortBusyError(name)
        self.is_open, self.opened = True, self.opened + 1
        return self


@pytest.fixture
def adapter(monkeypatch):
    adapter = Adapter()
    monkeypatch.setattr(ports, "open_transport", adapter.open_transport)
    return adapter


@pytest.fixture
def open_arm(adapter, tmp_path):
    """Return a function that opens an SO-101 whose first servo has the given id."""
    opened = []

    def open_arm(name, first_id):
        folder = tmp_path / f"{name}{first_id}"
        shutil.copytree(SO101, folder, dirs_exist_ok=True)
        text = (SO101 / "arm.toml").read_text().replace('"so101"', f'"{name}"')
        (folder / "arm.toml").write_text(
            re.sub(r"\bid = (\d)", lambda found: f"id = {int(found[1]) + first_id - 1}", text)
        )
        port = str(tmp_path / "adapter")
        opened.append(ikservo.open_arm(folder / "arm.toml", port, uncalibrated=True))
        return opened[-1]

    yield open_arm
    for arm in opened:
        arm.close()


@pytest.fixture
def arms(open_arm):
    return open_arm("left", 1), open_arm("right", 7)


def pan_deg(arm):
    return degrees(arm.where().positions_rad[0])


@pytest.mark.full
def test_one_arm_moves_while_other_on_same_adapter_holds(arms):
    left, right = arms
    left.move_joints({"shoulder_pan": radians(20.0)})
    right.move_joints({"shoulder_pan": radians(-10.0)})
    assert (pan_deg(left), pan_deg(right)) == (
        pytest.approx(20.0, abs=0.5), pytest.approx(-10.0, abs=0.5))  # fmt: skip


@pytest.mark.full
def test_one_arm_is_measured_while_the_other_moves(arms):
    left, right = arms
    seen = []
    left.move_joints(
        {"elbow_flex": radians(20.0)}, on_progress=lambda _: seen.append(pan_deg(right))
    )
    assert len(seen) > 20
    assert max(map(abs, seen)) < 0.5


def test_shared_adapter_is_closed_with_last_of_two_arms(arms, adapter):
    left, right = arms
    left.close()
    with pytest.raises(ikservo.PortError, match="closed"):
        left.where()
    right.move_joints({"shoulder_pan": radians(5.0)})
    right.close()
    assert not adapter.is_open


def test_closed_arm_reopens_while_other_arm_is_open(arms, open_arm, adapter):
    arms[0].close()
    assert pan_deg(open_arm("left", 1)) == pytest.approx(0.0, abs=0.5)
    assert adapter.opened == 1


def test_servo_ids_in_use_by_another_arm_are_refused(arms, open_arm):
    with pytest.raises(ikservo.PortBusyError):
        open_arm("third", 6)


def test_port_opened_without_servo_ids_is_refused_beside_arm(arms):
    with pytest.raises(ikservo.PortBusyError):
        ports.open_port(arms[0].port_name, BAUD)


def test_open_port_with_another_baud_rate_is_refused(arms):
    with pytest.raises(ikservo.PortError, match="is open at 1000000 baud; third needs 57600"):
        ports.open_port(arms[0].port_name, 57_600, "third", {21})


def test_two_arms_of_one_name_are_refused(open_arm):
    open_arm("left", 1)
    with pytest.raises(ikservo.PortError, match="An arm named left is open on"):
        open_arm("left", 7)


@pytest.mark.parametrize("stopped", [0, 1])
def test_stop_from_other_process_reaches_only_the_named_arm(arms, stopped):
    named, other = arms[stopped], arms[1 - stopped]
    for arm in arms:
        arm.enable()
    stop_arm(named.model, named.port_name)
    assert (bool(named.stopped_for), bool(other.stopped_for)) == (True, False)


@pytest.mark.full
def test_state_request_of_other_process_reads_its_own_arm(arms):
    arms[1].move_joints({"shoulder_pan": radians(15.0)})
    states = [query_state(arm.model, arm.port_name).joints[0].position_rad for arm in arms]
    assert states == [pytest.approx(0.0, abs=0.02), pytest.approx(radians(15.0), abs=0.02)]
