"""Targets and leader arms that an arm on another machine follows."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import cast

from ikservo.arm.arguments import check_callable, check_iterable
from ikservo.arm.arm_parts import ArmParts
from ikservo.arm.following import FollowResult
from ikservo.arm.leader_following import (
    PublishingLeader,
    leader_positions,
    published_positions,
    require_shared,
)
from ikservo.arm.reports import OnProgress
from ikservo.arm.target_tracking import CartesianOrJointTarget
from ikservo.clock import RealClock
from ikservo.errors import BadValueError
from ikservo.network.connection import Connection
from ikservo.network.motion_calls import MotionCalls
from ikservo.network.remote_stream import goal_fields, next_items

__all__ = ["RemoteFollowing"]

_PERIOD_S = 0.01


class RemoteFollowing:
    """Sends targets to an arm on another machine, a hundred a second.

    Args:
        connection: To the process beside the arm.
        calls: Motions of that process.
        joint_names: All joints of the arm.
    """

    def __init__(
        self, connection: Connection, calls: MotionCalls, joint_names: tuple[str, ...]
    ) -> None:
        self._connection, self._calls = connection, calls
        self._joint_names = joint_names

    def follow(
        self,
        targets: Iterable[CartesianOrJointTarget | None],
        speed: str,
        on_progress: OnProgress | None,
    ) -> FollowResult:
        """Follow a stream of targets until it ends; see ``Arm.follow``."""
        check_iterable("The stream of targets", targets, "an iterable of targets")
        items = next_items(RealClock(), targets, _PERIOD_S)

        def send_next() -> None:
            goal, ended = next(items, (None, True))
            if goal is not None:
                self._connection.send_setpoint(**goal_fields(goal, self._joint_names))
            elif ended:
                self._connection.send_setpoint(wanted=False)

        with self._calls.reporting(on_progress):
            pending = self._calls.start("follow", speed=speed)
            return cast("FollowResult", self._calls.await_result(pending, send_next, poll_s=0.0))

    def follow_arm(
        self,
        leader: object,
        until: Callable[[], bool] | None,
        speed: str,
        on_progress: OnProgress | None,
    ) -> FollowResult:
        """Follow another arm, guided by hand, on any machine; see ``Arm.follow_arm``.

        Raises:
            BadValueError: The leader is no arm.
            InputError: The arms have no joint in common.
        """
        check_callable("until", until)
        with self._positions_of(leader, until) as positions:
            return self.follow(positions, speed, on_progress)

    @contextmanager
    def _positions_of(
        self, leader: object, until: Callable[[], bool] | None
    ) -> Generator[Iterator[dict[str, float] | None]]:
        """Yield what measures the shared joints of a leader, here or on another machine."""
        if isinstance(leader, PublishingLeader):
            shared = self._shared_joints(leader.joint_names)
            with leader.published_positions() as newest:
                yield published_positions(newest, shared, _PERIOD_S, until)
        elif isinstance(leader, ArmParts):
            leading = leader.context
            leading.require_zeros()
            shared = self._shared_joints(leading.index.names)
            yield leader_positions(leading, shared, _PERIOD_S, until)
        else:
            raise BadValueError("The leader", repr(leader), "another open arm")

    def _shared_joints(self, leader: Sequence[str]) -> list[str]:
        """Return the joints that the arm has in common with a leader.

        Raises:
            InputError: There is none.
        """
        shared = [name for name in leader if name in self._joint_names]
        require_shared(shared, leader, self._joint_names)
        return shared
