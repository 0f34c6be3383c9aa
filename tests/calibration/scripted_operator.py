"""An operator who moves an arm's joints by a fixed schedule in virtual time."""

import math

from tests.calibration.mounted_arms import Operator

FIRST_S = 1.2  # the pose has been taken by then
PART_S = 0.4  # time of a motion in one direction
EACH_S = 3 * PART_S + 0.1


def schedule_operator(arm, subjects, skipped=()):
    """Schedule an operator: hold the pose, show each direction twice, then sweep all joints."""
    operator = Operator(arm)
    operator.hold_all()
    start_s = arm.world.time_s + FIRST_S
    moved = [s for s in subjects if s.name not in skipped]
    for k, subject in enumerate(moved):
        way = math.radians(25) * subject.free_direction * arm.joint(subject.name).m_per_rad
        for part, part_way in enumerate((way, -way, way)):
            at_s = start_s + k * EACH_S + part * PART_S
            arm.world.schedule(at_s, lambda n=subject.name, w=part_way: operator.move(n, w))
    names = [subject.name for subject in moved]
    arm.world.schedule(start_s + len(moved) * EACH_S, lambda: operator.sweep_all(names))
