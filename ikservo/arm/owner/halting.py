"""Stopping servos that somebody else set in motion: every goal becomes where the joint is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ikservo.clock import Clock
from ikservo.guard import Fence, Gate
from ikservo.hardware.bus import ServoBus
from ikservo.registers import Role

__all__ = ["Halted", "hold_servos"]

# A joint that moves by more in this time was on its way; one that rests keeps its goal, for its
# load has pulled it below, and a goal where it is would let it sink further at every stop.
_LOOK_S = 0.06
_MOVED_TICKS = 2
_ATTEMPTS = 3


@dataclass(frozen=True, slots=True)
class Halted:
    """What became of each joint.

    Attributes:
        held: Those that hold now.
        limp: Those without torque; nothing was changed there.
        silent: Those that did not answer; nobody knows.
    """

    held: tuple[str, ...]
    limp: tuple[str, ...]
    silent: tuple[str, ...]


def hold_servos(bus: ServoBus, fences: Sequence[Fence], clock: Clock) -> Halted:
    """Let every joint that has torque stay where it is; switches no torque."""
    ids = {fence.servo_id: fence for fence in fences}
    torque = bus.sync_read(ids, Role.TORQUE_ENABLE, raw=True).values
    on = [i for i, value in torque.items() if value]
    before = bus.sync_read(on, Role.PRESENT_POSITION, raw=True).values
    clock.sleep_until(clock.now_s() + _LOOK_S)
    present = bus.sync_read(on, Role.PRESENT_POSITION, raw=True).values
    goals = bus.sync_read(on, Role.GOAL_POSITION, raw=True).values
    moving = {
        ids[i].joint: tick
        for i, tick in present.items()
        if _on_its_way(ids[i], before.get(i), tick, goals.get(i))
    }
    _send(bus, fences, clock, moving)
    names = {i: fence.joint for i, fence in ids.items()}
    return Halted(
        held=tuple(names[i] for i in present),
        limp=tuple(names[i] for i, value in torque.items() if not value),
        silent=tuple(
            name for i, name in names.items() if i not in torque or (i in on and i not in present)
        ),
    )


def _on_its_way(fence: Fence, before: int | None, tick: int, goal: int | None) -> bool:
    if before is None or goal is None or abs(tick - before) > _MOVED_TICKS:
        return True
    return abs(goal - tick) > fence.lead_ticks(0.0)


def _send(bus: ServoBus, fences: Sequence[Fence], clock: Clock, ticks: Mapping[str, int]) -> None:
    def send(goals: Mapping[int, int]) -> None:
        bus.sync_write(Role.GOAL_POSITION, goals, raw=True)

    ids = {fence.joint: fence.servo_id for fence in fences}
    left = dict(ticks)
    for _ in range(_ATTEMPTS):  # no servo answers to a sync write: it is read back
        if left:
            Gate(fences, send, clock).start_from(left)
            goals = bus.sync_read([ids[name] for name in left], Role.GOAL_POSITION, raw=True).values
            left = {name: tick for name, tick in left.items() if goals.get(ids[name]) != tick}
