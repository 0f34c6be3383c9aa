"""Follow a leader arm that is guided by hand, on another port or another machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from ikservo.arguments import check_callable
from ikservo.arm.arm_protocol import OpenArm
from ikservo.clock import Rate, RealClock
from ikservo.errors import BadValueError, BusError, InputError, shown
from ikservo.model import Model
from ikservo.planning.context import ArmContext
from ikservo.planning.reports import FollowResult, OnProgress


def follow_arm(
    arm: OpenArm,
    leader: OpenArm,
    *,
    until: Callable[[], bool] | None = None,
    speed: str = "normal",
    on_progress: OnProgress | None = None,
) -> FollowResult:
    """Follow another arm that is guided by hand, coupling joints of the same name.

    ``leader`` is an open arm on another port or another machine. Its torque stays unchanged, and
    its gripper leads this arm's gripper. This arm keeps its own limits, and brakes if the leader
    does not answer for 0.3 s. Following ends when ``until``, called in every cycle, returns True.

    ``speed`` is the speed class; fast follows most closely. ``on_progress`` is called with a
    ``MotionProgress`` in every cycle.

    Raises:
        InputError: The arms have no joint in common.
        CalibrationError: One of the arms is not calibrated.
    """
    check_callable("on_progress", on_progress)
    check_callable("until", until)
    if leader is arm or not hasattr(leader, "leader_positions"):
        raise BadValueError("The leader", shown(leader), "another open arm")
    leader.zeros.require_known(leader.model.name)
    shared = shared_joints(leader.model, arm.model)
    with leader.leader_positions(shared, arm.target_period_s(), until) as positions:
        return arm.follow(positions, speed=speed, on_progress=on_progress)


def shared_joints(leader: Model, follower: Model) -> list[str]:
    """Return the joints that both arms have with the same name and kind.

    Raises:
        InputError: There is no such joint, or a joint is prismatic on one arm only.
    """
    units = {joint.name: joint.joint_map.unit for joint in follower.joints}
    own = {joint.name: joint.joint_map.unit for joint in leader.joints}
    shared = [name for name in own if name in units]
    if not shared:
        raise InputError(
            "The leader and the follower have no joint in common.",
            f"Joints of the leader: {', '.join(own)}; of the follower: {', '.join(units)}.",
        )
    for name in shared:
        if own[name] != units[name]:
            raise InputError(
                f"{name} is prismatic on one of the two arms and revolute on the other.",
                "These arms cannot be coupled.",
            )
    return shared


def published_positions(
    newest: Callable[[], dict[str, float] | None],
    shared: Sequence[str],
    cycle_time_s: float,
    until: Callable[[], bool] | None,
) -> Iterator[dict[str, float] | None]:
    """Yield the shared joints that ``newest`` returns in each cycle of real time, or None."""
    for _ in Rate(RealClock(), cycle_time_s):
        if until and until():
            return
        measured = newest()
        yield None if measured is None else {name: measured[name] for name in shared}


def leader_positions(
    leader: ArmContext,
    shared: Sequence[str],
    cycle_time_s: float,
    until: Callable[[], bool] | None = None,
) -> Iterator[dict[str, float] | None]:
    """Yield the leader's measured positions by joint in every cycle, or None if there is no reply.

    The torque of the leader stays unchanged.
    """
    for _ in Rate(leader.servos.clock, cycle_time_s):
        if until and until():
            return
        try:
            measured = leader.index.by_name(leader.servos.measure_positions())
        except BusError:
            yield None  # the follower waits briefly, then holds
        else:
            yield {name: measured[name] for name in shared}
