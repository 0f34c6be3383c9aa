"""The simulated servos behind an open arm, seen past every driver."""

from tests.oracle import arm_file, joints_from_ticks, tip_from_ticks


def line_of(arm):
    """Return the simulated line that the arm's port is on."""
    return arm._port.transport.line


def registers(arm, register):
    """Return one register of every servo by id, out of the simulated memories."""
    return {i: servo.read(register) for i, servo in line_of(arm).servos.items()}


def true_tip_m(arm):
    """Return the tip (3,) [m] that the servos' own position registers mean."""
    return tip_from_ticks(arm.model.name, registers(arm, "present_position"))


def true_joints(arm):
    return joints_from_ticks(arm.model.name, registers(arm, "present_position"))


def servo_id(name, joint):
    return next(j["servo"]["id"] for j in arm_file(name)["joints"] if j["name"] == joint)
