"""An arm of the page that is guided by hand and publishes its joint positions for a follower."""

from __future__ import annotations

import itertools
from collections.abc import Callable

from ikservo.apps.page.running.arm_job import JobObserver
from ikservo.arm import DEAD_MAN_TIMEOUT_S, Arm
from ikservo.clock import Clock, Rate
from ikservo.errors import BusError, IkservoError, StoppedError
from ikservo.serving.lease import is_fresh

_SHOWN_EVERY = 3  # the page is updated every third sample, because that delays the next one


class LeaderFeed:
    """Channel for the joint positions of a leader from its thread to its follower's thread.

    Args:
        name: The name of the leader, for messages; also an attribute.
        joint_names: The joints that both arms have; also an attribute.
        clock: The time of samples, for both threads.
        dead_man_s: The time for which a sample is valid.

    Attributes:
        newest: The last sample: its time, and positions by joint, rad or m.
        is_wanted: Returns whether the follower still needs samples; replaced once it has started.
    """

    def __init__(
        self, name: str, joint_names: tuple[str, ...], clock: Clock, dead_man_s: float
    ) -> None:
        self.name, self.joint_names = name, joint_names
        self.clock, self._dead_man_s = clock, dead_man_s
        self.newest: tuple[float, dict[str, float]] | None = None
        self.is_wanted: Callable[[], bool] = lambda: True
        self._failure = ""

    def publish(self, measured_s: float, positions: dict[str, float]) -> None:
        """Replace the newest sample; called by the leader's thread alone."""
        self.newest = (measured_s, positions)

    def fail(self, reason: str) -> None:
        """End following because the leader was stopped or does not answer."""
        self._failure = reason

    def positions(self) -> dict[str, float] | None:
        """Return the newest positions of the common joints; None before the first.

        Raises:
            StoppedError: The leader has failed, or sends no more samples.
        """
        newest = self.newest
        silent = newest is not None and not is_fresh(
            newest[0], self.clock.now_s(), self._dead_man_s
        )
        reason = self._failure or (f"no position for {self._dead_man_s} s." if silent else "")
        if reason:
            raise StoppedError(
                f"{self.name} no longer leads: {reason}",
                "Check both arms, then acknowledge each.",
            )
        return None if newest is None else {name: newest[1][name] for name in self.joint_names}


class LeadArm:
    """Job that publishes an arm's joint positions to a follower (``ArmJob``); moves nothing."""

    is_planned = False

    def __init__(self, feed: LeaderFeed, follower: str) -> None:
        self.title = f"Leading {follower}"
        self._feed, self._clock = feed, feed.clock

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Publish the joint positions until no arm follows.

        Raises:
            IkservoError: The arm was stopped, or a servo does not answer.
        """
        try:
            self._publish_positions(arm, observer)
        except IkservoError as error:
            self._feed.fail(error.message)
            raise

    def _publish_positions(self, arm: Arm, observer: JobObserver) -> None:
        servos, samples = arm.context.servos, itertools.count()
        answered_s = self._clock.now_s()
        for _ in Rate(self._clock, arm.runner.loop.measure_cycle_time_s()):
            if not self._feed.is_wanted():
                return
            try:
                measured = servos.measure_positions()
            except BusError:
                if self._clock.now_s() - answered_s > DEAD_MAN_TIMEOUT_S:
                    raise
                continue
            answered_s = self._clock.now_s()
            self._feed.publish(answered_s, arm.joint_index.by_name(measured))
            if next(samples) % _SHOWN_EVERY == 0:
                observer.on_guided(measured)
