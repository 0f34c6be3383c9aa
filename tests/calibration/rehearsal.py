"""A person who moves an arm's joints at times that were agreed on; time is virtual."""

import math

from tests.calibration.hidden import Person

FIRST_S = 1.2  # the pose has been taken by then
PART_S = 0.4  # of a motion one way
EACH_S = 3 * PART_S + 0.1


def rehearse(arm, loose_subjects, skipped=()):
    """Let a person hold the pose, show every direction twice in turn, then sweep all joints."""
    person = Person(arm)
    person.hold_all()
    start_s = arm.world.time_s + FIRST_S
    moved = [s for s in loose_subjects if s.name not in skipped]
    for k, subject in enumerate(moved):
        way = math.radians(25) * subject.free_direction * arm.joint(subject.name).m_per_rad
        for part, part_way in enumerate((way, -way, way)):
            at_s = start_s + k * EACH_S + part * PART_S
            arm.world.schedule(at_s, lambda n=subject.name, w=part_way: person.move(n, w))
    names = [subject.name for subject in moved]
    arm.world.schedule(start_s + len(moved) * EACH_S, lambda: person.sweep_all(names))
