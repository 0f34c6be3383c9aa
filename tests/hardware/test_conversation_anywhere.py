"""One conversation on every kind of port: in process, through a pseudo-terminal, on a real arm.

The real arm takes part with ``pytest -m hardware --real-port /dev/ttyACM0 [--real-arm so101]``.
Nothing moves and no torque comes on; what is written is written back.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ikservo.errors import RegisterAccessError, ServoSilentError
from ikservo.hardware import ServoBus, ServoSpec, open_port, read_eeprom, update_eeprom
from ikservo.registers import STS3215, RegisterName

from .conftest import read_servo_specs

CONFIGS = Path(__file__).parents[2] / "configs"
SERVE = "import sys, servosim; sys.exit(servosim.serve(sys.argv[1:]))"
ABSENT = ServoSpec(99, STS3215, "nobody")

ARMS = ("so101", "koch")
# A busy machine holds the server of a pseudo-terminal up for longer than three replies are awaited.
RETRIES = {"pty": 9}
LATE = {"pty": 0.02}  # so many replies of readings that are not repeated may be late there
MODES = ("", "?echo=1", "?echo=1&usb_frame_ms=1", "?latency_ms=16&usb_frame_ms=1")
PLACES = [
    *(
        pytest.param((f"sim{mode}", arm), id=f"virtual{mode}-{arm}")
        for arm in ARMS
        for mode in MODES
    ),
    *(pytest.param(("pty", arm), id=f"pty-{arm}") for arm in ARMS),
    pytest.param(("real", ""), marks=pytest.mark.hardware, id="real"),
]


@pytest.fixture(scope="module", params=PLACES)
def bus(request):
    """Return a bus with the arm's servos and one that is absent."""
    place, arm = request.param
    if place == "real":
        arm = request.config.getoption("--real-arm")
    path = CONFIGS / arm / "arm.toml"
    servos = [servo for servo in read_servo_specs(path) if "shadow" not in servo.name]
    absent = ServoSpec(ABSENT.id, servos[0].table, ABSENT.name)
    with (
        _Place(request, place, path) as name,
        ServoBus(
            open_port(name, 1_000_000), [*servos, absent], retries=RETRIES.get(place, 2)
        ) as bus,
    ):
        yield bus


class _Place:
    """The name of a port to the arm, and the server behind it if there is one."""

    def __init__(self, request, place, path):
        self.request, self.place, self.path, self.server = request, place, path, None

    def __enter__(self):
        if self.place.startswith("sim"):
            return f"sim:{self.path}{self.place.removeprefix('sim')}"
        if self.place == "real":
            return self.request.config.getoption("--real-port") or pytest.skip("no --real-port")
        pytest.importorskip("pty", reason="pseudo-terminals are a Unix thing")
        self.server = subprocess.Popen(
            [sys.executable, "-c", SERVE, str(self.path)], stdout=subprocess.PIPE, text=True
        )
        return self.server.stdout.readline().split()[-1]

    def __exit__(self, *_):
        if self.server:
            self.server.terminate()
            self.server.communicate(timeout=10)


@pytest.fixture
def ids(bus):
    return [servo_id for servo_id in bus.servos if servo_id != ABSENT.id]


@pytest.mark.full
def test_servo_models_match_arm_file(bus, ids):
    numbers = {i: bus.ping(i).model_number for i in ids}
    assert numbers == {i: bus.servos[i].table.number for i in ids}


@pytest.mark.sample(3)
def test_sync_read_equals_single_reads(bus, ids):
    together = bus.sync_read(ids, RegisterName.MAX_POSITION_LIMIT, raw=True).require_all()
    assert together == {i: bus.read(i, RegisterName.MAX_POSITION_LIMIT, raw=True) for i in ids}


def test_telemetry_voltage_and_temperature_are_plausible(bus, ids):
    wanted = [
        RegisterName.PRESENT_POSITION,
        RegisterName.PRESENT_VOLTAGE,
        RegisterName.PRESENT_TEMPERATURE,
    ]
    for row in bus.sync_read_many(ids, wanted).require_all().values():
        assert 4.0 < row[RegisterName.PRESENT_VOLTAGE] < 17.0
        assert 0.0 < row[RegisterName.PRESENT_TEMPERATURE] < 80.0


def test_missing_servo_does_not_affect_values_of_others(bus, ids):
    readings = bus.sync_read([*ids, ABSENT.id], RegisterName.PRESENT_POSITION)
    assert sorted(readings.values) == sorted(ids)
    assert isinstance(readings.errors[ABSENT.id], ServoSilentError)


def test_ping_of_missing_servo_gets_no_reply(bus):
    with pytest.raises(ServoSilentError, match="nobody"):
        bus.ping(ABSENT.id)


def test_written_register_is_read_back_and_restored(bus, ids):
    before = bus.read(ids[0], RegisterName.PROFILE_VELOCITY, raw=True)
    try:
        bus.write(ids[0], RegisterName.PROFILE_VELOCITY, 123, raw=True)
        assert bus.read(ids[0], RegisterName.PROFILE_VELOCITY, raw=True) == 123
    finally:
        bus.write(ids[0], RegisterName.PROFILE_VELOCITY, before, raw=True)


def test_sync_write_reaches_all_servos(bus, ids):
    before = bus.sync_read(ids, RegisterName.PROFILE_VELOCITY, raw=True).require_all()
    try:
        bus.sync_write(RegisterName.PROFILE_VELOCITY, dict.fromkeys(ids, 77), raw=True)
        now = bus.sync_read(ids, RegisterName.PROFILE_VELOCITY, raw=True).require_all()
        assert now == dict.fromkeys(ids, 77)
    finally:
        bus.sync_write(RegisterName.PROFILE_VELOCITY, before, raw=True)
        bus.ping(ids[0])


def test_unchanged_eeprom_value_is_not_written(bus, ids):
    servo = bus.servos[ids[0]]
    held = read_eeprom(bus, servo.id)
    limit = servo.table.max_temperature_limit
    assert update_eeprom(bus, servo.id, {limit: held[limit.name]}) == []


def test_write_to_measured_register_is_refused(bus, ids):
    with pytest.raises(RegisterAccessError, match="read-only"):
        bus.write(ids[0], RegisterName.PRESENT_POSITION, 0)


@pytest.mark.sample(3)
def test_thousand_position_reads_are_all_answered(bus, ids, request):
    asked = 1000 // len(ids)
    answered = sum(
        not bus.sync_read(ids, RegisterName.PRESENT_POSITION).errors for _ in range(asked)
    )
    place, _ = request.node.callspec.params["bus"]
    assert answered >= (1.0 - LATE.get(place, 0.0)) * asked


def test_round_trip_time_of_every_servo_is_measured(bus, ids):
    for servo_id in ids:
        bus.read(servo_id, RegisterName.PRESENT_POSITION)
        assert 0.0 < bus.statistics[servo_id].round_trip_s(0.5) < 0.1
