"""A simulated, randomly mounted arm behind a serial port, and its calibration."""

from datetime import UTC, datetime

from ikservo.apps.calibrating.calibration_result import CalibrationResult
from tests.calibration.factories import make_calibration
from tests.calibration.mounted_arms import make_mounted_arm
from tests.cli.fixtures_ports import PortInfo, set_ports

PORT, SERIAL = "/dev/ttyBENCH", "58FA083"
WHEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)


def connect_arm(monkeypatch, name, seed=7, serial=SERIAL, **how):
    """Connect a randomly mounted arm to the port and return it."""
    set_ports(monkeypatch, [PortInfo(PORT, serial_number=serial)])
    arm = make_mounted_arm(name, seed, pose="home", **how)

    def open_transport(port, baud_rate):
        arm.port.is_open = True
        return arm.port

    monkeypatch.setattr("ikservo.hardware.port.open_transport", open_transport)
    arm.port.name = PORT
    return arm


def write_calibration(arm, serial=SERIAL):
    """Save a calibration anchored at the arm's present position, and return it."""
    with arm.open_limp() as limp_arm:
        limp_arm.serial_number = serial
        calibration = make_calibration(arm, limp_arm, WHEN)
        memory = {s.id: s.holds for joint in calibration.joints for s in joint.servos}
        limp_arm.save(CalibrationResult(calibration, memory))
    return calibration
