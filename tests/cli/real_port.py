"""A hidden arm on what looks like a serial port, and its calibration as if by hand."""

from datetime import UTC, datetime

from ikservo.calibration.result import CalibrationResult
from tests.calibration.hidden import hidden_arm
from tests.calibration.plain import plain_calibration
from tests.cli.desk import Comport, plug_in

PORT, SERIAL = "/dev/ttyDESK", "58FA083"
WHEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)


def put(monkeypatch, name, seed=7, serial=SERIAL, **how):
    """Put a hidden arm on the desk and return it."""
    plug_in(monkeypatch, [Comport(PORT, serial_number=serial)])
    arm = hidden_arm(name, seed, pose="home", **how)

    def open_transport(port, baud_rate):
        arm.port.is_open = True
        return arm.port

    monkeypatch.setattr("ikservo.hardware.port.open_transport", open_transport)
    arm.port.name = PORT
    return arm


def calibrate_plainly(arm, serial=SERIAL):
    """Save a calibration whose anchor is where the arm stands, and return it."""
    with arm.loose() as loose:
        loose.serial_number = serial
        calibration = plain_calibration(arm, loose, WHEN)
        memory = {s.id: s.holds for joint in calibration.joints for s in joint.servos}
        loose.save(CalibrationResult(calibration, memory))
    return calibration
