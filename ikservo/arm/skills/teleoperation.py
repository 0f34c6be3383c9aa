"""Leading one arm by another: the measured joints of the leader are the follower's wishes."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ikservo.arm.skills.workings import Workings
from ikservo.errors import BusError, InputError
from ikservo.motion import Metronome

__all__ = ["led_by", "shared_joints"]


def shared_joints(leader: Workings, follower: Workings) -> list[str]:
    """Return the joints that both arms have by name and kind.

    Raises:
        InputError: There is none, or a joint of the leader slides and the follower's turns.
    """
    units = {fence.joint: fence.joint_map.unit for fence in follower.servos.fences}
    own = {fence.joint: fence.joint_map.unit for fence in leader.servos.fences}
    shared = [name for name in own if name in units]
    if not shared:
        raise InputError(
            f"{leader.model.title} and {follower.model.title} have no joint in common.",
            f"Joints of the leader: {', '.join(own)}; of the follower: {', '.join(units)}.",
        )
    for name in shared:
        if own[name] != units[name]:
            raise InputError(
                f"{name} is prismatic on one of the two arms and revolute on the other.",
                "Such arms cannot be coupled.",
            )
    return shared


def led_by(
    leader: Workings,
    follower: Workings,
    beat_s: float,
    until: Callable[[], bool] | None = None,
) -> Iterator[dict[str, float] | None]:
    """Yield the leader's measured joints by name at each beat, or None where it did not answer.

    Args:
        leader: Who leads; its torque is left as it is.
        follower: Who follows.
        beat_s: Between two looks at the leader.
        until: Ends it by returning True.
    """
    shared = shared_joints(leader, follower)
    columns = [leader.planner.column(name) for name in shared]
    for _ in Metronome(leader.servos.clock, beat_s):
        if until and until():
            return
        try:
            measured = leader.servos.measure()
        except BusError:
            yield None  # the follower waits a little, then holds
        else:
            yield {name: float(measured[c]) for name, c in zip(shared, columns, strict=True)}
