"""Check every goal once more just before it is sent, independently of the guard."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from ikservo.errors import RefusedError
from ikservo.hardware.bus import ServoBus
from ikservo.registers import RegisterName


def write_goals(
    bus: ServoBus,
    goals: Mapping[int, int],
    ranges: Mapping[int, tuple[int, int]],
    *,
    reached: Callable[[int], Iterable[int]] = lambda _: (),
    describe: Callable[[int, int], str] | None = None,
    confirmed: bool = False,
) -> None:
    """Write goal positions of servos; no other code in this program writes goals.

    A goal must be inside the servo's range, or between the range and the tick that it has reached:
    a joint that sank out of its limits can be held there and moved back, but not further out.

    Args:
        bus: The servos.
        goals: Raw ticks by servo id.
        ranges: The lowest and the highest goal of each servo, inclusive.
        reached: Returns the tick at which a servo is, or to which it was last sent; called only if
            a goal is outside.
        describe: Returns the message for a refused goal, given servo id and tick.
        confirmed: Whether each servo confirms its goal by a reply; if not, one packet contains all
            goals.

    Raises:
        RefusedError: A goal is outside its range, or its servo has no range; nothing was sent.
        RegisterAccessError: The torque of a servo is off; nothing was sent.
        BusError: A servo does not confirm its goal.
    """
    for servo_id, tick in goals.items():
        low, high = ranges.get(servo_id, (0, -1))
        if low <= tick <= high:
            continue
        known = (low, high, *reached(servo_id))
        if servo_id not in ranges or not min(known) <= tick <= max(known):
            usual = f"The goal {tick} of {bus.servos[servo_id]} is outside {low} to {high}."
            raise RefusedError(describe(servo_id, tick) if describe else usual, "Nothing was sent.")
    if confirmed:
        for servo_id, tick in goals.items():
            bus.write(servo_id, RegisterName.GOAL_POSITION, tick, raw=True)
    else:
        bus.sync_write(RegisterName.GOAL_POSITION, goals, raw=True)
