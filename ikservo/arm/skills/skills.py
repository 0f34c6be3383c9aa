"""What an arm can do besides going somewhere: jog, follow, grip, learn poses, record and replay."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, Unpack, overload

from numpy.typing import ArrayLike

from ikservo.arm.background import Motion
from ikservo.arm.given import check_callable, file_path
from ikservo.arm.motion_options import JointOptions
from ikservo.arm.planning import Inside
from ikservo.arm.reports import JointReport
from ikservo.arm.skills.gripping import GripReport, Opening, grip
from ikservo.arm.skills.poses import Poses
from ikservo.arm.skills.steered import OnProgress, Steered
from ikservo.arm.tapes.recording import RecordReport, heading_of, record
from ikservo.arm.tapes.replaying import ReplayReport, replay
from ikservo.errors import BadValueError

__all__ = ["Skills"]


class Skills(Steered, ABC):
    """The base of ``Arm``: each skill has a room of its own, and works with its ``workings``.

    Attributes:
        workings: The inside of the arm.
        poses: The poses of its arm file, and those it was taught.
    """

    poses: Poses

    @overload
    def move_joints(
        self,
        positions: Mapping[str, float] | ArrayLike,
        *,
        wait: Literal[True] = True,
        **options: Unpack[JointOptions],
    ) -> JointReport: ...
    @overload
    def move_joints(
        self,
        positions: Mapping[str, float] | ArrayLike,
        *,
        wait: Literal[False],
        **options: Unpack[JointOptions],
    ) -> Motion[JointReport]: ...
    @abstractmethod
    def move_joints(
        self,
        positions: Mapping[str, float] | ArrayLike,
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> JointReport | Motion[JointReport]:
        """Move some joints; see ``Arm``."""

    @abstractmethod
    def inside(self, pose: str) -> Inside:
        """Return a named pose inside this arm's limits; see ``Arm``."""

    @abstractmethod
    def hold(self) -> None:
        """Hold; see ``Arm``."""

    @abstractmethod
    def relax(self, on_progress: OnProgress | None = None) -> JointReport:
        """Lower and let go; see ``Arm``."""

    @overload
    def pose(
        self, name: str, *, wait: Literal[True] = True, **options: Unpack[JointOptions]
    ) -> JointReport: ...
    @overload
    def pose(
        self, name: str, *, wait: Literal[False], **options: Unpack[JointOptions]
    ) -> Motion[JointReport]: ...
    def pose(
        self,
        name: str,
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> JointReport | Motion[JointReport]:
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
        inside = self.inside(name)
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
        self.poses.taught()  # a spoiled file is found before anybody carries the arm around
        if until is not None:
            if any(state.torque for state in servos.states()):
                self.relax()
            until()
        measured = servos.measure()
        positions = dict(zip(servos.names, measured.tolist(), strict=True))
        self.poses.save(name, positions)
        if hold:
            self.hold()
        return positions

    @overload
    def gripper(
        self,
        to: Opening | float | None = None,
        *,
        width_m: float | None = None,
        force: float | None = None,
        on_progress: OnProgress | None = None,
        wait: Literal[True] = True,
    ) -> GripReport: ...
    @overload
    def gripper(
        self,
        to: Opening | float | None = None,
        *,
        width_m: float | None = None,
        force: float | None = None,
        on_progress: OnProgress | None = None,
        wait: Literal[False],
    ) -> Motion[GripReport]: ...
    def gripper(
        self,
        to: Opening | float | None = None,
        *,
        width_m: float | None = None,
        force: float | None = None,
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> GripReport | Motion[GripReport]:
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

        def move() -> GripReport:
            return grip(self.workings, goal, force, on_progress)

        return self._background.do(move) if wait else self._background.start(move)

    def record(
        self,
        path: Path | str,
        *,
        duration_s: float | None = None,
        until: Callable[[], bool] | None = None,
        period_s: float = 0.02,
        overwrite: bool = False,
    ) -> RecordReport:
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
        servos, path = self.workings.servos, file_path(path)
        check_callable("until", until)
        heading = heading_of(self.workings.model, period_s)
        return record(servos.measure, servos.clock, path, heading, duration_s, until,
                      overwrite=overwrite)  # fmt: skip

    @overload
    def replay(
        self, path: Path | str, *, wait: Literal[True] = True, **options: Unpack[JointOptions]
    ) -> ReplayReport: ...
    @overload
    def replay(
        self, path: Path | str, *, wait: Literal[False], **options: Unpack[JointOptions]
    ) -> Motion[ReplayReport]: ...
    def replay(
        self,
        path: Path | str,
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> ReplayReport | Motion[ReplayReport]:
        """Go to the first pose of a recording of this arm, then along it.

        It goes as fast as recorded where that is within the speed class, else slower as a whole.

        Raises:
            FileFormatError: It is spoiled, or another arm's; says in which line.
            RefusedError: It leaves this arm's limits, or something is in the way; nothing moved.
            CalibrationError: Nobody knows where the arm's zeros are.
        """
        path = file_path(path)
        check_callable("on_progress", on_progress)
        self.workings.zeros.check(self.workings.model.name)
        self.workings.model.speed(speed)

        def move() -> ReplayReport:
            return replay(self.workings, path, speed, on_progress)

        return self._background.do(move) if wait else self._background.start(move)
