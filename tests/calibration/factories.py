"""Calibrations without an operator: every joint swept around its present position."""

from ikservo.apps.calibrating.by_hand_procedure import CalibrationState

STEP = 60


def make_swept_state(limp_arm, signs, margin_rad=0.02):
    """Return a calibration state with each joint swept by 720 ticks in both directions.

    Args:
        limp_arm: The arm with torque off, in its pose home.
        signs: The direction of growing ticks, by servo id.
        margin_rad: Margin of the limits inside the sweep.
    """
    _, ticks = limp_arm.read_ticks()
    state = CalibrationState(limp_arm.make_subjects("home"), margin_rad)
    for k in range(60):
        state = state.update(0.02 * k, ticks)
    state, at_s = state.accept(), 2.0
    for way, ids in _moves(state, signs):
        at_s += 0.02
        ticks = {i: (tick + STEP * way * (i in ids)) % 4096 for i, tick in ticks.items()}
        state = state.update(at_s, ticks)
    return state


def _moves(state, signs):
    """Yield steps: each joint twice in its shown direction and back, then all both ways."""
    for subject in state.subjects:
        shown, ids = signs[subject.servo_id] * subject.free_direction, _ids(subject)
        yield from ([(shown, ids)] * 4 + [(-shown, ids)] * 4) * 2
    every = {i for subject in state.subjects for i in _ids(subject)}
    yield from [(1, every)] * 12 + [(-1, every)] * 24 + [(1, every)] * 12


def _ids(subject):
    return {subject.servo_id, *subject.shadow_ids}


def make_calibration(arm, limp_arm, when, write_limits=True):
    """Return the calibration of a sweep around the present position."""
    signs = {i: arm.direction(i) for i in arm.line.servos}
    state = make_swept_state(limp_arm, signs)
    assert state.current_joint is None
    return limp_arm.build_calibration(state, "home", when, write_limits=write_limits).calibration
