"""Job of an arm that follows another arm of the page; joints of the same name are coupled."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np

from ikservo.apps.page.running.arm_job import JobObserver
from ikservo.apps.page.running.follow_lag import LagMeter
from ikservo.apps.page.running.leader import LeaderFeed
from ikservo.arm import Arm, MotionProgress
from ikservo.arm.following import follow_targets
from ikservo.errors import RefusedError, StoppedError
from ikservo.kinematics.arrays import Vector


class FollowLeader:
    """Job that follows a leader until ``finish`` is called (``ArmJob``).

    Attributes:
        lag: The lag of the arm.
        refusal: The reason why the guard refused the leader's last posture; empty if it did not.
    """

    is_planned = False

    def __init__(self, feed: LeaderFeed, speed: str) -> None:
        self.title = f"Following {feed.name}"
        self.feed, self._speed = feed, speed
        self.lag = LagMeter(feed.joint_names)
        self.refusal = ""
        self._finished = threading.Event()

    def finish(self) -> None:
        """End the motion and let the arm hold; safe from any thread."""
        self._finished.set()

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Follow the leader until ``finish`` is called.

        Raises:
            IkservoError: The arm was stopped, or the leader failed.
        """
        names = self.feed.joint_names
        columns = [arm.joint_index.column(name) for name in names]

        def record(progress: MotionProgress) -> None:
            observer.on_progress(progress)
            newest = self.feed.newest
            if newest is not None:
                led: Vector = np.array([newest[1][name] for name in names])
                followed = (progress.setpoints_rad[columns], progress.joints_rad[columns])
                self.lag.record(newest[0], led, self.feed.clock.now_s(), *followed)

        def note_refusal(error: RefusedError, _kept: Vector) -> None:
            self.refusal = error.message
            observer.log_message(error.message)

        result = follow_targets(arm, self._positions(), self._speed, record, note_refusal)
        if not self._finished.is_set():
            raise StoppedError(
                f"{self.feed.name} no longer leads: {result.ended}.",
                "Check both arms, then acknowledge.",
            )

    def _positions(self) -> Iterator[dict[str, float] | None]:
        """Yield the leader's joint positions, once per control cycle."""
        while not self._finished.is_set():
            yield self.feed.positions()
