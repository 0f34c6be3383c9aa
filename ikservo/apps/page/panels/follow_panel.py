"""Panel for the choice of a leader, and for the lag of the follower."""

from __future__ import annotations

import math
from collections.abc import Callable

from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.running.follow_job import FollowLeader
from ikservo.apps.page.running.follow_lag import MAX_LAG_S
from ikservo.apps.page.running.leader import LeadArm, LeaderFeed
from ikservo.apps.page.server.message_age_and_rate import Client
from ikservo.apps.page.server.server import Frame
from ikservo.arm import Arm
from ikservo.arm.leader_following import shared_joints
from ikservo.clock import Clock
from ikservo.errors import InputError

_PERIOD_S = 0.4  # update period of figures for a reader
_FOLLOWED = 0.05  # rad or m; below this error a refusal is not shown

FindArm = Callable[[str], ArmThread | None]
"""Function that returns the thread of another open arm by its name; None if there is none."""


class FollowPanel:
    """Coupling of the arm to a leader, another arm of the page, with a display of its lag."""

    def __init__(self, arm_thread: ArmThread, clock: Clock, find_arm: FindArm) -> None:
        self._arm_thread, self._clock, self._find_arm = arm_thread, clock, find_arm
        self._job: FollowLeader | None = None
        self._fields: Frame = {"kind": "following", "leader": None}
        self._reported_s = -math.inf

    def start(self, leader_name: str) -> None:
        """Follow another arm of the page: first move to its position, then move with it.

        Raises:
            InputError: There is no such arm, its torque is on, one of the arms is busy or was
                stopped, or they have no joint in common.
            CalibrationError: One of the two arms is not calibrated.
        """
        leader = self._find_arm(leader_name)
        if leader is None or leader is self._arm_thread:
            raise InputError(
                f"No other arm {leader_name!r} is open.", "Open it from the list of arms."
            )
        follower = self._arm_thread.arm
        for arm in (leader.arm, follower):
            arm.context.require_zeros()
        if all(state.torque for state in leader.snapshot.states):
            raise InputError(
                f"{leader_name} holds its position, so you cannot guide it.",
                "Release it first; an arm that is not supported falls.",
            )
        joints = tuple(shared_joints(leader.arm.model, follower.model))
        feed = LeaderFeed(leader_name, joints, self._clock, self._arm_thread.lease.timeout_s)
        job = FollowLeader(feed, self._arm_thread.command.speed)
        try:
            leader.request_job(LeadArm(feed, follower.model.title))
        except InputError as error:
            raise InputError(f"{leader_name}: {error.message}", error.command_hint) from error
        try:
            self._arm_thread.request_job(job)
        except InputError:
            feed.is_wanted = lambda: False
            raise
        feed.is_wanted = lambda: self._arm_thread.job is job
        self._job = job

    def finish(self) -> None:
        """Stop following; the arm holds."""
        if self._job is not None:
            self._job.finish()

    def frames(self, client: Client) -> list[Frame]:
        """Return the frame with the leader's name and lag, unless the client already has it."""
        job, now_s = self._job, self._clock.now_s()
        if job is not None and self._arm_thread.job is not job:
            self._job, self._reported_s = None, -math.inf
            self._fields = {"kind": "following", "leader": None}
        elif job is not None and now_s - self._reported_s >= _PERIOD_S:
            self._reported_s = now_s
            rows = _lag_rows(self._arm_thread.arm, job)
            self._fields = {"kind": "following", "leader": job.feed.name, "lag": rows}
        return client.unsent(self._fields)


def _lag_rows(arm: Arm, job: FollowLeader) -> list[tuple[str, str]]:
    """Return the rows of names and values for the page."""
    lag = job.lag.read()
    if lag is None:
        return []
    slides = arm.model.joint(lag.joint).joint_map.unit == "m"
    error = f"{1000 * lag.error:.1f} mm" if slides else f"{math.degrees(lag.error):.1f}°"
    rows = [
        ("goal behind the leader", _format_lag(lag.goal_s)),
        ("arm behind the leader", _format_lag(lag.arm_s)),
        ("largest error", f"{error} {lag.joint}"),
    ]
    refused = job.refusal and lag.error > _FOLLOWED
    return [*rows, ("not followed", job.refusal)] if refused else rows


def _format_lag(lag_s: float | None) -> str:
    if lag_s is None:
        return "– (leader still)"
    return f"{'over ' if lag_s >= MAX_LAG_S else ''}{1000 * lag_s:.0f} ms"
