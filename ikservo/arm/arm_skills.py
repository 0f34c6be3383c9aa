"""Skills of an arm: jog, follow, gripper, taught poses, recordings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, Unpack, cast, overload

from numpy.typing import ArrayLike

from ikservo.arm.arguments import check_callable, parse_path
from ikservo.arm.background_motion import Background, Motion
from ikservo.arm.context import ArmContext
from ikservo.arm.following import CartesianOrJointTarget, FollowResult, follow, leader_positions
from ikservo.arm.gripper import GraspResult, GripperCommand, move_gripper
from ikservo.arm.jogging import JogResult, KeepGoing, jog
from ikservo.arm.motion_options import JointOptions, OnProgress
from ikservo.arm.plan import Inside
from ikservo.arm.poses import PoseLibrary
from ikservo.arm.recording import RecordResult, record, recording_header
from ikservo.arm.replay import ReplayResult, replay
from ikservo.arm.reports import JointMoveResult
from ikservo.arm.setpoint_stream import SetpointStream
from ikservo.errors import BadValueError

__all__ = ["Skills", "Steered"]


class Steered:
    """The part of ``Skills`` that goes on for as long as somebody wants it.

    Attributes:
        workings: The inside of the arm.
    """

    workings: ArmContext
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
        self.workings.zeros.require_known(self.workings.model.name)
        self.workings.model.speed(speed)
        self._check_open()
        return SetpointStream(self.workings, self._background.start_stream, speed, rate_hz)

    def jog(self, what: str, speed: float | None = None, *, wanted: KeepGoing) -> JogResult:
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
        wishes: Iterable[CartesianOrJointTarget | None],
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
    ) -> FollowResult:
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
        self.workings.zeros.require_known(self.workings.model.name)
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
    ) -> FollowResult:
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
        leader.workings.zeros.require_known(leader.workings.model.name)
        cycle_time_s = self.workings.servos.measure_cycle_time_s()
        return self.follow(
            leader_positions(leader.workings, self.workings, cycle_time_s, until),
            speed=speed,
            on_progress=on_progress,
        )


class Skills(Steered, ABC):
    """The base of ``Arm``: each skill has a room of its own, and works with its ``workings``.

    Attributes:
        workings: The inside of the arm.
        poses: The poses of its arm file, and those it was taught.
    """

    poses: PoseLibrary

    @overload
    def move_joints(
        self,
        positions: Mapping[str, float] | ArrayLike,
        *,
        wait: Literal[True] = True,
        **options: Unpack[JointOptions],
    ) -> JointMoveResult: ...
    @overload
    def move_joints(
        self,
        positions: Mapping[str, float] | ArrayLike,
        *,
        wait: Literal[False],
        **options: Unpack[JointOptions],
    ) -> Motion[JointMoveResult]: ...
    @abstractmethod
    def move_joints(
        self,
        positions: Mapping[str, float] | ArrayLike,
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> JointMoveResult | Motion[JointMoveResult]:
        """Move some joints; see ``Arm``."""

    @abstractmethod
    def pose_within_limits(self, pose: str) -> Inside:
        """Return a named pose inside this arm's limits; see ``Arm``."""

    @abstractmethod
    def hold(self) -> None:
        """Hold; see ``Arm``."""

    @abstractmethod
    def relax(self, on_progress: OnProgress | None = None) -> JointMoveResult:
        """Lower and let go; see ``Arm``."""

    @overload
    def pose(
        self, name: str, *, wait: Literal[True] = True, **options: Unpack[JointOptions]
    ) -> JointMoveResult: ...
    @overload
    def pose(
        self, name: str, *, wait: Literal[False], **options: Unpack[JointOptions]
    ) -> Motion[JointMoveResult]: ...
    def pose(
        self,
        name: str,
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> JointMoveResult | Motion[JointMoveResult]:
        """Go to a pose of the arm file, or to one that was taught.

        Joints that a pose leaves on their end stops go to their limits, and those of the rest pose
        in any case: ``binding`` of the report says which.

        Args:
            name: Its name.
            speed: slow, normal or fast.
            on_progress: Called in every control cycle.
            wait: Whether to block; else the motion runs in the background, see ``move_to``.

        Raises:
            UnknownNameError: There is no such pose; the closest is offered.
            RefusedError: It lies outside this arm's limits, or something is in the way.
        """
        self.workings.model.speed(speed)
        inside = self.pose_within_limits(name)
        goal = inside.positions
        if not wait:
            return self.move_joints(goal, speed=speed, on_progress=on_progress, wait=False)
        report = self.move_joints(goal, speed=speed, on_progress=on_progress)
        return replace(report, binding=inside.changed + report.binding)

    def teach(
        self, name: str, until: Callable[[], object] | None = None, *, hold: bool = False
    ) -> dict[str, float]:
        """Keep where the joints are as a pose of this arm's own; return them, rad or m by name.

        Args:
            name: 1 to 64 of A-Z a-z 0-9 _ -, and no pose of the arm file.
            until: Returns when a person has brought the arm where they want it. The arm is relaxed
                first, where it holds; without this it is not touched.
            hold: Whether the arm then holds itself there.

        Raises:
            BadValueError: The name cannot be used; nothing has moved.
            FileWriteError: The pose cannot be kept.
        """
        servos = self.workings.servos
        check_callable("until", until)
        self.poses.check_name(name)
        self.poses.user_poses()  # a spoiled file is found before anybody carries the arm around
        if until is not None:
            if any(state.torque for state in servos.read_states()):
                self.relax()
            until()
        measured = servos.measure_positions()
        positions = dict(zip(servos.names, measured.tolist(), strict=True))
        self.poses.save(name, positions)
        if hold:
            self.hold()
        return positions

    @overload
    def gripper(
        self,
        to: GripperCommand | float | None = None,
        *,
        width_m: float | None = None,
        force: float | None = None,
        on_progress: OnProgress | None = None,
        wait: Literal[True] = True,
    ) -> GraspResult: ...
    @overload
    def gripper(
        self,
        to: GripperCommand | float | None = None,
        *,
        width_m: float | None = None,
        force: float | None = None,
        on_progress: OnProgress | None = None,
        wait: Literal[False],
    ) -> Motion[GraspResult]: ...
    def gripper(
        self,
        to: GripperCommand | float | None = None,
        *,
        width_m: float | None = None,
        force: float | None = None,
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> GraspResult | Motion[GraspResult]:
        """Open or close the gripper, or bring its jaws to a width.

        It stops pressing where something stands between the jaws, and goes on holding it with no
        more than the given force.

        Args:
            to: open, close, or a width in metres where the arm file knows widths.
            width_m: The same width, by name.
            force: The share of the servo's torque that it may use, 0.05 to 1; 0.3 if None.
            on_progress: Called in every control cycle.
            wait: Whether to block; else the motion runs in the background, see ``move_to``.

        Raises:
            IkservoError: The arm has no gripper.
            RefusedError: A jaw would touch something on its way; nothing has moved.
            BadValueError: The width is out of its range or unknown, or the force is no share.
        """
        check_callable("on_progress", on_progress)
        goal = to if width_m is None else width_m
        if goal is None or (to is not None and width_m is not None):
            raise BadValueError("The motion of the gripper", "not clear", "open, close or a width")

        def move() -> GraspResult:
            return move_gripper(self.workings, goal, force, on_progress)

        return self._background.run_blocking(move) if wait else self._background.start(move)

    def record(
        self,
        path: Path | str,
        *,
        duration_s: float | None = None,
        until: Callable[[], bool] | None = None,
        period_s: float = 0.02,
        overwrite: bool = False,
    ) -> RecordResult:
        """Write the measured joints to a file at a fixed rate; torque stays as it is.

        Ctrl-C ends it; what was recorded stays.

        Args:
            path: A new file, JSON lines behind a header.
            duration_s: How long; until ``until`` says so if None.
            until: Asked at each sample; True ends it.
            period_s: Between two samples.
            overwrite: Whether a file that is there may be lost.

        Raises:
            BadValueError: The file is there, or a number makes no sense.
            FileWriteError: It cannot be written.
            ServoSilentError: A servo does not answer; what was recorded stays.
        """
        servos, path = self.workings.servos, parse_path(path)
        check_callable("until", until)
        heading = recording_header(self.workings.model, period_s)
        return record(servos.measure_positions, servos.clock, path, heading, duration_s, until,
                      overwrite=overwrite)  # fmt: skip

    @overload
    def replay(
        self, path: Path | str, *, wait: Literal[True] = True, **options: Unpack[JointOptions]
    ) -> ReplayResult: ...
    @overload
    def replay(
        self, path: Path | str, *, wait: Literal[False], **options: Unpack[JointOptions]
    ) -> Motion[ReplayResult]: ...
    def replay(
        self,
        path: Path | str,
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> ReplayResult | Motion[ReplayResult]:
        """Go to the first pose of a recording of this arm, then along it.

        It goes as fast as recorded where that is within the speed class, else slower as a whole.

        Raises:
            FileFormatError: It is spoiled, or another arm's; says in which line.
            RefusedError: It leaves this arm's limits, or something is in the way; nothing moved.
            CalibrationError: Nobody knows where the arm's zeros are.
        """
        path = parse_path(path)
        check_callable("on_progress", on_progress)
        self.workings.zeros.require_known(self.workings.model.name)
        self.workings.model.speed(speed)

        def move() -> ReplayResult:
            return replay(self.workings, path, speed, on_progress)

        return self._background.run_blocking(move) if wait else self._background.start(move)
