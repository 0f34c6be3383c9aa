"""Compare the rest positions of simulated and real servos after pulls to both sides.

Run ``python tools/bench/pulled_servo.py``. The stand holds a servo at a goal; elastic bands pull
its horn to one side for half a second, slacken for a second, and then pull to the other. The table
has the distance between the positions while it is pulled, and after each release, beside that in
the stand's registers. The pull is known only roughly: 0.15 to 0.3 N m. Figures belong in
docs/lab/simulated-motors.md.
"""

from __future__ import annotations

import math

from servosim.control import DriveCommand
from servosim.motor import Motor
from servosim.parameters import PARAMETERS

DT_S = 0.001
TICK_RAD = 2.0 * math.pi / 4096
PULLS_NM = (0.15, 0.2, 0.25, 0.3)
PULLED_S, RELEASED_S, RISE_S = 0.5, 1.0, 0.15
HORN_KG_M2 = 1e-4  # a bar of 100 mm
# Start-up force and dead zone of the stand's servos, as their load registers show, and the reported
# distances of the positions [ticks]: while pulled, after release.
STAND = {
    "STS3215": (0.0, 1, 14.8, 7.0),
    "STS3215-C018": (0.0, 1, 14.8, 7.0),  # the stand's supply is not known
    "STS3250": (0.0, 0, 3.8, 1.5),
}


def ticks_apart(model: str, startup: float, dead_ticks: int, pull_nm: float) -> tuple[float, float]:
    """Return the distance of the positions [ticks], while pulled and after release.

    Args:
        model: Model of the servo.
        startup: Duty of its start-up force.
        dead_ticks: Its dead zone.
        pull_nm: Torque of the bands.
    """
    motor = Motor(PARAMETERS[model])
    motor.load_inertia_kg_m2 = HORN_KG_M2
    drive = DriveCommand(
        True, kp=0.163 * 32, tick_rad=TICK_RAD, dead_zone_rad=dead_ticks * TICK_RAD,
        startup_pwm=startup,
    )  # fmt: skip
    found: list[tuple[float, float]] = []
    for side in (1.0, -1.0, 1.0, -1.0):
        pulled = _run(motor, drive, PULLED_S, 0.0, side * pull_nm)
        found.append((pulled, _run(motor, drive, RELEASED_S, side * pull_nm, 0.0)))
    (high, above), (low, below) = found[-2:]
    return high - low, above - below


def _run(
    motor: Motor, drive: DriveCommand, seconds: float, start_nm: float, end_nm: float
) -> float:
    """Return the position [ticks] after a pull that changes evenly and then stays."""
    for k in range(round(seconds / DT_S)):
        load_nm = start_nm + (end_nm - start_nm) * min(1.0, k * DT_S / RISE_S)
        motor.step(DT_S, load_nm, drive, motor.parameters.nominal_v)
    return motor.position_rad / TICK_RAD


def main() -> None:
    """Print the table."""
    print("| ticks apart, pulled / released | stand | " + " | ".join(map(str, PULLS_NM)) + " N m |")
    print("|---|---:|" + "---:|" * len(PULLS_NM))
    for model, (startup, dead_ticks, pulled, released) in STAND.items():
        found = [ticks_apart(model, startup, dead_ticks, pull_nm) for pull_nm in PULLS_NM]
        cells = " | ".join(f"{p:.1f} / {r:.1f}" for p, r in found)
        print(f"| {model} | {pulled} / {released} | {cells} |")


if __name__ == "__main__":
    main()
