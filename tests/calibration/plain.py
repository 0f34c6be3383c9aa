"""A calibration made without hands: as if every joint had been swept around where it is."""

from ikservo.calibration.procedure import CalibrationState

STEP = 60


def plain_wizard(loose, signs, margin_rad=0.02):
    """Return a conversation at its sweep in which each joint has gone 720 ticks both ways.

    Args:
        loose: The arm, in its pose home.
        signs: The direction of growing ticks, by servo id.
        margin_rad: As a calibration takes it.
    """
    _, ticks = loose.read_ticks()
    wizard = CalibrationState.begin(loose.make_subjects("home"), margin_rad)
    for k in range(60):
        wizard = wizard.update(0.02 * k, ticks)
    wizard, at_s = wizard.accept(), 2.0
    for way, ids in _moves(wizard, signs):
        at_s += 0.02
        ticks = {i: (tick + STEP * way * (i in ids)) % 4096 for i, tick in ticks.items()}
        wizard = wizard.update(at_s, ticks)
    return wizard


def _moves(wizard, signs):
    """Yield steps: each joint twice in its shown direction and back, then all both ways."""
    for subject in wizard.subjects:
        shown, ids = signs[subject.servo_id] * subject.free_direction, _ids(subject)
        yield from ([(shown, ids)] * 4 + [(-shown, ids)] * 4) * 2
    every = {i for subject in wizard.subjects for i in _ids(subject)}
    yield from [(1, every)] * 12 + [(-1, every)] * 24 + [(1, every)] * 12


def _ids(subject):
    return {subject.servo_id, *subject.shadow_ids}


def plain_calibration(arm, loose, when, write_limits=True):
    """Return what that conversation ends with."""
    signs = {i: arm.direction(i) for i in arm.line.servos}
    wizard = plain_wizard(loose, signs)
    assert wizard.current_joint is None
    return loose.build_calibration(wizard, "home", when, write_limits=write_limits).calibration
