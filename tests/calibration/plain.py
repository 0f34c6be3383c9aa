"""A calibration made without hands: as if every joint had been swept by a patient person."""

from ikservo.calibration.sweep import Wizard


def plain_wizard(loose, pose="home", margin_rad=0.02):
    """Return a conversation at its review in which every joint was swept around where it is."""
    _, ticks = loose.read()
    wizard = Wizard.begin(loose.subjects(pose), margin_rad)
    for k in range(60):
        wizard = wizard.read(0.02 * k, ticks)
    wizard = wizard.accept()
    at_s = 2.0
    for way in (1, -1, -1, 1):
        for _ in range(12):
            at_s += 0.02
            for i in ticks:
                ticks[i] = (ticks[i] + way * 60) % 4096
            wizard = wizard.read(at_s, ticks)
    while wizard.asked:
        wizard = wizard.skip(wizard.asked.name)
    return wizard


def plain_calibration(loose, when, write_limits=True):
    return loose.conclude(plain_wizard(loose), "home", when, write_limits=write_limits).calibration
