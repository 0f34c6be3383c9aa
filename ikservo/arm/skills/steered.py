"""What an arm does while somebody steers it: jogging, and following wishes or another arm."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable
from typing import cast

from ikservo.arm.background import Background, SetpointStream
from ikservo.arm.given import check_callable
from ikservo.arm.reports import Progress
from ikservo.arm.skills.following import FollowReport, follow
from ikservo.arm.skills.jogging import JogReport, Wanted, jog
from ikservo.arm.skills.teleoperation import led_by
from ikservo.arm.skills.tracking import Wish
from ikservo.arm.skills.workings import Workings
from ikservo.errors import BadValueError

__all__ = ["OnProgress", "Steered"]

OnProgress = Callable[[Progress], None]


class Steered:
    """The part of ``Skills`` that goes on for as long as somebody wants it.

    Attributes:
        workings: The inside of the arm.
    """

    workings: Workings
    _background: Background

    @abstractmethod
    def _check_open(self) -> None:
        """Refuse where the arm was closed; see ``Arm``."""

    def stream(self, *, speed: str = "normal", rate_hz: float | None = None) -> SetpointStream:
        """Open a stream of setpoints, which the program pushes at its own rate.

        ::

            with arm.stream(speed="fast", rate_hz=50) as stream:
                for q in trajectory:           # (n,), or {"elbow_flex": 0.3}, or a Target
                    stream.send(q)

        Each setpoint is gone to from the moment it is sent, as fast as the speed class allows and
        without a jump, through the guard; the newest one counts. After 0.3 s without one, and at
        the end of the block, the arm brakes where it is not there yet, and holds. An error ends
        the stream and is raised by the next ``send``, or at the end of the block.

        Args:
            speed: slow, normal or fast; fast keeps closest.
            rate_hz: How many setpoints a second, 5 to 1000: ``send`` returns when the next is due.
                If None it returns at once, and the program keeps its own time.

        Raises:
            CalibrationError: Nobody knows where the arm's zeros are.
            BadValueError: The rate makes no sense.
            RefusedError: Another stream is open.
        """
        self.workings.zeros.check(self.workings.model.name)
        self.workings.model.speed(speed)
        self._check_open()
        return SetpointStream(self.workings, self._background.start_stream, speed, rate_hz)

    def jog(self, what: str, speed: float | None = None, *, wanted: Wanted) -> JogReport:
        """Let a joint or the tip go on in one direction for as long as somebody wants it.

        Args:
            what: A joint, or x, y, z, -x, -y, -z, up, down in the arm's base frame.
            speed: rad/s of a joint (m/s of a slide) or m/s of the tip; negative the other way. The
                arm file's slow speed, or 0.05 m/s, if None.
            wanted: Asked at each beat: True goes on, False brakes and holds, None is no news.
                After 0.3 s without news it brakes and holds, too.

        Returns:
            Where it ended, and why: no longer requested, a limit, or the guard.

        Raises:
            UnknownNameError: No such joint or direction.
            BadValueError: The speed is zero, not finite or too high.
        """
        return jog(self.workings, what, speed, wanted)

    def follow(
        self,
        wishes: Iterable[Wish | None],
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
    ) -> FollowReport:
        """Follow a stream of wishes, one at each beat, until it ends or falls silent.

        Each beat takes the next item: a ``Target``, a point (3,) [m], a pose (4, 4) of the tip,
        positions by joint [rad or m], or None for nothing new. The arm goes there as fast as its
        speed class allows, without a stop or a jump, and keeps to its branch. A wish lasts for
        0.3 s: after the stream's end, or as long a silence, it brakes where it is not there yet.

        Then load is made up for, as at the end of ``move_to``: the joints are led to the last wish
        that the guard took, or to where they were braked on the way there, and held. This is left
        out where it was stopped or the stream raised an error: then it holds as it stands.

        Args:
            wishes: The stream; a generator may wait for what it yields.
            speed: slow, normal or fast.
            on_progress: Called at every beat.

        Raises:
            BadValueError: An item is no wish; the arm was braked first.
            StoppedError: Somebody stopped it; the arm holds.
        """
        self.workings.zeros.check(self.workings.model.name)
        self.workings.model.speed(speed)
        check_callable("on_progress", on_progress)
        if not isinstance(cast("object", wishes), Iterable):
            raise BadValueError("The stream of targets", repr(wishes), "an iterable of targets")
        return follow(self.workings, wishes, speed, on_progress)

    def follow_arm(
        self,
        leader: Steered,
        *,
        speed: str = "normal",
        until: Callable[[], bool] | None = None,
        on_progress: OnProgress | None = None,
    ) -> FollowReport:
        """Follow another arm that a person leads by hand, joint by joint of the same name.

        The leader's torque is left as it is; its gripper leads the gripper. This arm's own limits
        hold, and where the leader does not answer for 0.3 s, it brakes and holds.

        Args:
            leader: An open arm on another port.
            speed: slow, normal or fast; fast keeps closest.
            until: Ends it by returning True.
            on_progress: Called at every beat.

        Raises:
            InputError: The arms have no joint in common.
            CalibrationError: Nobody knows where the leader's zeros are.
        """
        if not isinstance(cast("object", leader), Steered) or leader is self:
            raise BadValueError("The leader", repr(leader), "another open arm")
        check_callable("until", until)
        leader.workings.zeros.check(leader.workings.model.name)
        cycle_time_s = self.workings.servos.measure_cycle_time_s()
        return self.follow(
            led_by(leader.workings, self.workings, cycle_time_s, until),
            speed=speed,
            on_progress=on_progress,
        )
