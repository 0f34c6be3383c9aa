"""Follow a leader arm, guided by hand, on another port or another machine."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Protocol, runtime_checkable

from ikservo.arm.arguments import check_callable
from ikservo.arm.arm_parts import ArmParts
from ikservo.arm.context import ArmContext
from ikservo.arm.following import FollowResult, follow_targets
from ikservo.arm.reports import OnProgress
from ikservo.clock import Rate, RealClock
from ikservo.errors import BadValueError, BusError, InputError

__all__ = [
    "PublishingLeader",
    "follow_arm",
    "leader_positions",
    "published_positions",
    "require_shared",
    "shared_joints",
]


@runtime_checkable
class PublishingLeader(Protocol):
    """A leader on another machine, which publishes its joints."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Its joints."""
        ...

    def published_positions(self) -> AbstractContextManager[Callable[[], dict[str, float] | None]]:
        """Return, for a ``with`` block, what takes the newest positions by joint once."""
        ...


def published_positions(
    newest: Callable[[], dict[str, float] | None],
    shared: Sequence[str],
    cycle_time_s: float,
    until: Callable[[], bool] | None,
) -> Iterator[dict[str, float] | None]:
    """Yield the newest positions of shared joints, or None, in real time.

    Args:
        newest: Takes the newest positions by joint once.
        shared: The joints that the leader has in common with the follower.
        cycle_time_s: Between two items.
        until: Ends it by returning True.
    """
    for _ in Rate(RealClock(), cycle_time_s):
        if until and until():
            return
        measured = newest()
        yield None if measured is None else {name: measured[name] for name in shared}


def follow_arm(
    arm: ArmParts,
    leader: ArmParts | PublishingLeader,
    *,
    until: Callable[[], bool] | None = None,
    speed: str = "normal",
    on_progress: OnProgress | None = None,
) -> FollowResult:
    """Follow another arm, guided by hand, joint by joint of the same name.

    ``leader`` is an open arm on another port or another machine; its torque is left as it is,
    its gripper leads the gripper. This arm keeps its own limits, and brakes where the leader does
    not answer for 0.3 s. It ends when ``until``, called in every control cycle, returns True.

    ``speed`` is the speed class: fast keeps closest. ``on_progress`` is called with a
    ``MotionProgress`` in every cycle.

    Raises:
        InputError: The arms have no joint in common.
        CalibrationError: One of the arms is not calibrated.
    """
    check_callable("on_progress", on_progress)
    check_callable("until", until)
    own = arm.context
    if isinstance(leader, PublishingLeader):
        shared = [name for name in leader.joint_names if name in own.index.names]
        require_shared(shared, leader.joint_names, own.index.names)
        cycle_time_s = arm.runner.loop.measure_cycle_time_s()
        with leader.published_positions() as newest:
            published = published_positions(newest, shared, cycle_time_s, until)
            return follow_targets(arm, published, speed, on_progress)
    leading = _leader_context(arm, leader)
    leading.require_zeros()
    cycle_time_s = arm.runner.loop.measure_cycle_time_s()
    shared = shared_joints(leading, own)
    positions = leader_positions(leading, shared, cycle_time_s, until)
    return follow_targets(arm, positions, speed, on_progress)


def _leader_context(arm: ArmParts, leader: object) -> ArmContext:
    if not isinstance(leader, ArmParts) or leader is arm:
        raise BadValueError("The leader", repr(leader), "another open arm")
    return leader.context


def shared_joints(leader: ArmContext, follower: ArmContext) -> list[str]:
    """Return the joints that both arms have by name and kind.

    Raises:
        InputError: There is none, or a joint is prismatic on one of them and revolute on the other.
    """
    units = {driven.joint: driven.joint_map.unit for driven in follower.servos.driven_joints}
    own = {driven.joint: driven.joint_map.unit for driven in leader.servos.driven_joints}
    shared = [name for name in own if name in units]
    require_shared(shared, own, units)
    for name in shared:
        if own[name] != units[name]:
            raise InputError(
                f"{name} is prismatic on one of the two arms and revolute on the other.",
                "Such arms cannot be coupled.",
            )
    return shared


def require_shared(shared: Sequence[str], leader: Iterable[str], follower: Iterable[str]) -> None:
    """Refuse two arms without a joint of the same name.

    Raises:
        InputError: They have none.
    """
    if not shared:
        raise InputError(
            "The leader and the follower have no joint in common.",
            f"Joints of the leader: {', '.join(leader)}; of the follower: {', '.join(follower)}.",
        )


def leader_positions(
    leader: ArmContext,
    shared: Sequence[str],
    cycle_time_s: float,
    until: Callable[[], bool] | None = None,
) -> Iterator[dict[str, float] | None]:
    """Yield the leader's measured joints by name in every cycle, or None without a reply.

    Args:
        leader: The arm that is guided by hand; its torque is left as it is.
        shared: The joints that it has in common with the follower.
        cycle_time_s: Between two readings of the leader.
        until: Ends it by returning True.
    """
    for _ in Rate(leader.servos.clock, cycle_time_s):
        if until and until():
            return
        try:
            measured = leader.index.by_name(leader.servos.measure_positions())
        except BusError:
            yield None  # the follower waits a little, then holds
        else:
            yield {name: measured[name] for name in shared}
