"""Common interface of open arms, whose servos are on this machine or on another one.

``Arm`` and ``RemoteArm`` (``ikservo.apps.remote``) implement it. Code that accepts either of them
uses this type; code that needs the servos uses an ``Arm``, see ``require_own_port`` in
``ikservo.arm.opening``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self, runtime_checkable

from numpy.typing import ArrayLike

from ikservo.arm.background_motion import Background
from ikservo.arm.motion_methods import MotionMethods, Positions
from ikservo.arm.motion_runner import MotionRunner
from ikservo.clock import Clock
from ikservo.ik import Target
from ikservo.kinematics import Chain, JointIndex
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model
from ikservo.planning.calibrated_arm import ZeroSource
from ikservo.planning.context import ArmContext
from ikservo.planning.poses import PoseLibrary, PoseWithinLimits
from ikservo.planning.preflight_planner import PreflightPlanner
from ikservo.planning.reports import (
    ArmState,
    FollowResult,
    JogResult,
    JointMoveResult,
    MotionProgress,
    OnProgress,
)

if TYPE_CHECKING:
    from ikservo.arm.scene import Scene
    from ikservo.arm.target_tracking import CartesianOrJointTarget


KeepGoing = Callable[[], bool | None]
"""Function called in every cycle: True continues, False ends the jog, None is no decision."""


@runtime_checkable
class ArmParts(Protocol):
    """The parts of an arm that motion functions need; ``Arm`` provides them.

    A function whose first parameter is an ``ArmParts`` can be a method of ``Arm``.
    """

    @property
    def context(self) -> ArmContext:
        """The servos, model, calibration and checks of the arm."""
        ...

    @property
    def runner(self) -> MotionRunner:
        """The runner of the arm's motions."""
        ...

    @property
    def preflight(self) -> PreflightPlanner:
        """The planner and checker of the arm's motions."""
        ...

    @property
    def scene(self) -> Scene:
        """The things around the arm, and the things that its gripper holds."""
        ...

    @property
    def background(self) -> Background:
        """The runner of motions for which the program does not wait."""
        ...


class GoalStream(Protocol):
    """A stream that accepts setpoints in a ``with`` block; see ``Arm.stream``.

    Attributes:
        unreached: The number of setpoints out of reach; the arm moved as close to them as it could.
        refused: The number of setpoints that the guard refused; the arm kept the previous one.
        reason: The reason for the last refusal.
        kept: The goal (n,) kept at the last refusal, rad or m; None before that, or if the arm is
            on another machine.
    """

    unreached: int
    refused: int
    reason: str
    kept: Vector | None

    def __enter__(self) -> Self:
        """Start accepting setpoints."""
        ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None:
        """Brake and hold."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints, in the order used in arrays (n,)."""
        ...

    @property
    def sent(self) -> int:
        """Number of setpoints sent."""
        ...

    @property
    def progress(self) -> MotionProgress | None:
        """The last control cycle; None before the first, or if the loop is on another machine."""
        ...

    def send(self, setpoint: Mapping[str, float] | ArrayLike | Target) -> None:
        """Send a setpoint; it replaces the previous one."""


class OpenArm(MotionMethods, Protocol):
    """An open arm, with servos on this machine or another one. See ``Arm`` for each method.

    Attributes:
        model: The arm's model.
        chain: The joints from base to tool; their limits are those of this arm, at whole ticks.
        zeros: The source of the joint zeros.
        poses: The poses in the arm file, and taught poses.
        joint_index: The columns of the joints in vectors of all joints (n,).
    """

    model: Model
    chain: Chain
    zeros: ZeroSource
    poses: PoseLibrary
    joint_index: JointIndex

    def __enter__(self) -> Self:
        """Return the arm; leaving the block closes it.

        Raises:
            PortError: The arm has already been closed.
        """
        ...

    @property
    def is_remote(self) -> bool:
        """Whether the servos are on another machine."""
        ...

    @property
    def port_name(self) -> str:
        """The name of the port to which the arm is connected, or the arm's address."""
        ...

    @property
    def clock(self) -> Clock:
        """The clock of the arm's motions: simulated time on a simulated bus of this machine."""
        ...

    def limits(self) -> tuple[Vector, Vector]:
        """Return the lower and upper limits (n,), rad or m, at whole ticks; read-only arrays."""
        ...

    def clearance_m(self, positions: Positions) -> float:
        """Return the smallest distance [m] between parts of the arm, or to the table or a box."""
        ...

    def where(self) -> ArmState:
        """Measure the tip, the joints and the servos' health."""
        ...

    def last_state(self) -> ArmState:
        """Return the state of the last control cycle."""
        ...

    # torque and stops

    def relax(self, on_progress: OnProgress | None = None) -> JointMoveResult:
        """Lower the arm slowly to its rest pose, then switch every servo's torque off."""
        ...

    def disable_torque(self) -> None:
        """Switch every servo's torque off; an arm that is not supported falls."""

    def reconnect(self, within_s: float = 10.0) -> None:
        """Open the port again after the cable was unplugged; refused on another machine."""

    def return_within_limits(self) -> None:
        """Slowly move joints that are slightly outside their limits back inside."""

    @property
    def stop_requests(self) -> int:
        """Number of stop requests since the last ``acknowledge``."""
        ...

    def acknowledge(self) -> None:
        """Acknowledge a stop: the arm may be moved again, but nothing moves yet."""

    # poses and goals

    def pose_within_limits(self, pose: str, start: Vector | None = None) -> PoseWithinLimits:
        """Clamp a named pose to this arm's limits, which may exclude it."""
        ...

    def teach(
        self, name: str, until: Callable[[], object] | None = None, *, hold: bool = False
    ) -> dict[str, float]:
        """Save the measured positions as a pose of this arm; return them, rad or m by joint."""
        ...

    def jog(self, what: str, speed: float | None = None, *, wanted: KeepGoing) -> JogResult:
        """Move a joint or the tip in one direction while ``wanted`` returns True."""
        ...

    def follow(
        self,
        targets: Iterable[CartesianOrJointTarget | None],
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
    ) -> FollowResult:
        """Follow a stream of targets until it ends."""
        ...

    def follow_arm(
        self,
        leader: OpenArm,
        *,
        until: Callable[[], bool] | None = None,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
    ) -> FollowResult:
        """Follow another arm that is guided by hand, coupling joints of the same name."""
        ...

    def target_period_s(self) -> float:
        """Return the time between two targets of ``follow``; only for use inside this package."""
        ...

    def leader_positions(
        self, joints: Sequence[str], period_s: float, until: Callable[[], bool] | None
    ) -> AbstractContextManager[Iterator[dict[str, float] | None]]:
        """Return a context manager that provides measured joint positions for a follower.

        For functions of this package. An item is None if there is no newer measurement.
        """
        ...

    def stream(self, *, speed: str = "normal", rate_hz: float | None = None) -> GoalStream:
        """Open a stream of setpoints, which the program sends at its own rate."""
        ...
