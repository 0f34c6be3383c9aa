"""The service of an open arm for other programs, independent of the transport.

Anyone may stop the arm and read its state. One operator at a time moves it, under the lease. An
operator who falls silent loses the lease, and the arm holds until someone acknowledges the stop.

A transport (``control_server`` for this machine, ``apps/remote/arm_server.py`` for others)
identifies clients, parses their requests, calls this class, and encodes the results.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Protocol

from ikservo.arm.arm_protocol import OpenArm
from ikservo.arm.motion_runner import MotionRunner
from ikservo.clock import Clock, RealClock
from ikservo.control.stop_requests import StopOutcome
from ikservo.errors import IkservoError
from ikservo.guard import StopKind, StopReason
from ikservo.kinematics.arrays import FrozenArrays, Vector
from ikservo.planning.reports import JointMoveResult
from ikservo.serving.control_client import BRAKE_TIMEOUT_S, StopResult
from ikservo.serving.lease import IDLE_TIMEOUT_S, ArmLease, Holder

_WATCH_PERIOD_S = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class ArmDescription(FrozenArrays):
    """The description of an arm that another program needs in addition to the model.

    Attributes:
        version: The version of ikservo.
        arm: The arm's name.
        port: The port of the arm.
        zeros: The name of the ``ZeroSource`` of the joints.
        joints: Names of all joints, in the order used in vectors (n,).
        lower: Lower limits (n,), rad or m.
        upper: Upper limits (n,), rad or m.
        chain: Names of the joints from base to tip.
        chain_lower: Lower limits of the chain (dof,).
        chain_upper: Upper limits of the chain (dof,).
        origins: The calibrated origin of each joint of the chain, T_parent_joint row by row (16,).
    """

    version: str
    arm: str
    port: str
    zeros: str
    joints: tuple[str, ...]
    lower: Vector
    upper: Vector
    chain: tuple[str, ...]
    chain_lower: Vector
    chain_upper: Vector
    origins: dict[str, tuple[float, ...]]


class ServableArm(OpenArm, Protocol):
    """An arm whose port is open in this process, such as an ``Arm``."""

    @property
    def runner(self) -> MotionRunner:
        """The runner of the arm's motions."""
        ...


class ArmService:
    """Handler of the requests from an open arm's clients; every method is safe in any thread.

    Args:
        arm: The arm.
        clock: The clock of the lease.
        on_lost: Called after a running motion ended because its operator fell silent.

    Attributes:
        lease: The control lease of the arm.
    """

    def __init__(
        self,
        arm: ServableArm,
        clock: Clock | None = None,
        on_lost: Callable[[], object] = lambda: None,
    ) -> None:
        self.arm, self.clock = arm, clock or RealClock()
        self.lease = ArmLease(self.clock)
        self._on_lost = on_lost

    @property
    def port(self) -> str:
        """The name of the arm's port, without the options of a simulated one."""
        name = self.arm.port_name
        return "sim" if name.startswith("sim:") else name

    # anybody

    def stop(
        self, reason: StopReason, at_rest: StopReason | None = None, lease: str = ""
    ) -> StopResult:
        """Stop the arm, whoever moves it, and return the state of each joint once the arm rests.

        If an operator stops its own motion, this returns at once: the motion reports its end.

        ``at_rest`` is the reason if no motion is running; None uses ``reason``.

        Raises:
            IkservoError: The arm has not come to rest, or the servos cannot be commanded to hold.
        """
        arm, runner = self.arm, self.arm.runner
        is_operated = self.lease.moving is not None
        is_own = self.lease.is_held_by(lease)
        if is_own and (is_operated or reason.kind is StopKind.CANCELLED):
            runner.request_stop(reason)
            return StopResult(arm.model.name, self.port, True, arm.joint_names, (), ())
        reason = StopReason(StopKind.CLIENT, reason.text)
        if is_operated:  # a motion that is still planned does not hold the lock
            runner.request_stop(reason)
        moving = False
        if not runner.lock.acquire(blocking=False):  # a motion or a reading
            if not is_operated:
                runner.request_stop(reason if runner.motion_running else at_rest or reason)
            moving = runner.motion_running
            self._wait_for_lock()
        try:
            outcome = StopOutcome(arm.joint_names, (), ())  # the arm holds after a motion
            if not moving:
                outcome = runner.stop_servos(at_rest or reason)
        finally:
            runner.lock.release()
        return StopResult(arm.model.name, self.port, moving, **asdict(outcome))

    def relax(self, stopped: StopReason, relaxed: StopReason) -> JointMoveResult:
        """Stop the arm, lower it and switch torque off; it then stays stopped.

        ``stopped`` is the reason for the stop of a running motion; ``relaxed`` is the reason for
        which the arm stays stopped afterwards.

        Raises:
            IkservoError: The arm does not come to rest, or cannot be lowered.
        """
        self.stop(stopped)
        self._wait_for_lock()
        try:
            self.arm.acknowledge()
            report = self.arm.relax()
            self.arm.runner.latch_stop(relaxed)
        finally:
            self.arm.runner.lock.release()
        return report

    def describe(self) -> ArmDescription:
        """Describe the arm to a program that already has the model."""
        arm = self.arm
        lower, upper = arm.limits()
        return ArmDescription(
            version=version("ikservo"),
            arm=arm.model.name,
            port=self.port,
            zeros=arm.zeros.name,
            joints=arm.joint_names,
            lower=lower,
            upper=upper,
            chain=arm.chain.names,
            chain_lower=arm.chain.lower_rad,
            chain_upper=arm.chain.upper_rad,
            origins={
                step.joint.name: tuple(step.joint.origin.ravel().tolist())
                for step in arm.chain.joints_to()
            },
        )

    def health(self) -> dict[str, object]:
        """Return the arm's health as plain values: state, stop, operator, temperature, alarms."""
        arm, holder, reason = self.arm, self.lease.holder, self.arm.stop_reason
        state = arm.where()
        torque = any(joint.torque for joint in state.joints)
        moving = "moving" if self.lease.moving is not None else "holds" if torque else "limp"
        return {
            "arm": arm.model.name,
            "port": self.port,
            "state": moving if reason is None else "stopped",
            "stop_kind": "" if reason is None else reason.kind.name,
            "stop_text": "" if reason is None else reason.text,
            "stop_requests": arm.stop_requests,
            "operator": "" if holder is None else holder.operator,
            "temperature_c": max(joint.temperature_c for joint in state.joints),
            "alarms": [f"{j.name}: {', '.join(j.alarms)}" for j in state.joints if j.alarms],
            "dropped_setpoints": self.lease.dropped,
        }

    # the operator

    def release(self, lease: str) -> bool:
        """Accept the lease that an operator returns; a running motion ends."""
        holder = self.lease.holder
        if holder is None or holder.lease != lease:
            return False
        return self.lose(holder, f"{holder.operator} released control; the arm holds its position.")

    def lose(self, holder: Holder, text: str) -> bool:
        """Withdraw a lease and stop its holder's motion; return whether the lease was in force."""
        if not self.lease.release(holder.lease):
            return False
        if self.lease.moving == holder:
            self.end_motion(text)
        return True

    def end_motion(self, text: str) -> None:
        """Stop the motion that an operator has requested, with ``text`` as the reason."""
        if self.lease.moving is not None:
            self.arm.request_stop(StopReason(StopKind.CLIENT, text))
        self._on_lost()

    def watch_operator(self, closing: threading.Event) -> None:
        """Withdraw the lease of any operator who falls silent, until ``closing`` is set.

        The time limit is the dead-man time-out during a motion, otherwise 3 s.
        """
        while not closing.is_set():
            limit_s = self.lease.timeout_s if self.lease.moving is not None else IDLE_TIMEOUT_S
            holder, left_s = self.lease.holder, limit_s - self.lease.silence_s()
            if holder is None:
                left_s = _WATCH_PERIOD_S
            elif left_s <= 0.0:
                silence = f"nothing was received from {holder.operator} for {limit_s:.1f} s"
                self.lose(holder, f"{silence}; the arm holds its position.")
            closing.wait(min(max(left_s, 0.001), _WATCH_PERIOD_S))

    def close(self, text: str) -> None:
        """Refuse control from now on, and stop an operator's motion with ``text`` as the reason."""
        self.lease.close()
        self.end_motion(text)

    def _wait_for_lock(self) -> None:
        if not self.arm.runner.lock.acquire(timeout=BRAKE_TIMEOUT_S):
            raise IkservoError(
                "The program that moves the arm did not stop on request.",
                "End that program, or switch off the arm's power.",
            )
