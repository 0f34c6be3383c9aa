"""The simulated servos behind an open arm, read without any driver.

Only this module accesses the parts of an open arm: its port, its servos and its motion runner.
"""

from dataclasses import replace

from ikservo.arm import ZeroSource
from tests.oracle import arm_file, joints_from_ticks, tip_from_ticks


def transport_of(arm):
    """Return the simulated serial port of the arm."""
    return arm.context.port.transport


def line_of(arm):
    """Return the simulated bus of the arm."""
    return transport_of(arm).line


def clock_of(arm):
    """Return the virtual clock of the arm and its bus."""
    return transport_of(arm).clock


def context_of(arm):
    """Return the context of the arm: its servos, planner and collision checker."""
    return arm.context


def without_zeros(arm):
    """Return the arm as if it had never been calibrated."""
    arm._context = replace(arm._context, zeros=ZeroSource.UNKNOWN)
    return arm


def motion_runner(arm):
    """Return the motion runner of the arm."""
    return arm.runner


def servo_group(arm):
    """Return the servo group of the control loop: goals, limits, torque state."""
    return context_of(arm).servos


def gate_of(arm):
    """Return the gate that every goal of an arm passes."""
    return servo_group(arm)._gate


def motion_limits(arm, speed):
    """Return the kinematic limits of every joint at a speed: slow, normal or fast."""
    return context_of(arm).planner.motion_limits(speed)


def run_trajectory(arm, make_trajectory, on_cycle, speed):
    """Run a trajectory like every motion of the arm, without planning and settling.

    Args:
        arm: The arm.
        make_trajectory: Called with the joints that the arm holds (n,).
        on_cycle: Called in each control cycle, or None.
        speed: slow, normal or fast.
    """
    motion_runner(arm).run(make_trajectory, on_cycle, speed)


def registers(arm, register):
    """Return one register of every servo by id, from the simulated memories."""
    return {i: servo.read(register) for i, servo in line_of(arm).servos.items()}


def true_tip_m(arm):
    """Return the tip (3,) [m] that the servos' position registers give."""
    return tip_from_ticks(arm.model.name, registers(arm, "present_position"))


def true_joints(arm):
    return joints_from_ticks(arm.model.name, registers(arm, "present_position"))


def servo_id(name, joint):
    return next(j["servo"]["id"] for j in arm_file(name)["joints"] if j["name"] == joint)


def call_before(owner, name, monkeypatch, action):
    """Do an action once, just before a method is called."""
    original, done = getattr(owner, name), []

    def wrapped(*args, **kwargs):
        if not done:
            done.append(True)
            action()
        return original(*args, **kwargs)

    monkeypatch.setattr(owner, name, wrapped, raising=True)
    return done
