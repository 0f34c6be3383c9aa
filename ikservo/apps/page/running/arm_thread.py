"""The thread that owns the arm: it follows commands and holds when they stop arriving."""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ikservo.apps.page.dragging.goal_planning import refusal_of
from ikservo.apps.page.dragging.labels import describe_stop
from ikservo.apps.page.dragging.snapshot import (
    ArmCommand,
    ArmSnapshot,
    CalibrationView,
    LogEntry,
    StopNotice,
)
from ikservo.apps.page.running.arm_job import ArmJob
from ikservo.apps.page.running.calibration_panel import CalibrationDriver
from ikservo.apps.page.running.history import History
from ikservo.apps.page.running.limp_picture import LimpPicture
from ikservo.apps.page.running.live_session import LiveSession
from ikservo.arm import (
    DEAD_MAN_TIMEOUT_S,
    Arm,
    MotionProgress,
    StopKind,
    StopReason,
)
from ikservo.arm.following import HAND_JERK_FACTOR, HAND_SLOW_S
from ikservo.clock import Clock
from ikservo.control.loop import ControlCycle
from ikservo.errors import (
    BusError,
    IkservoError,
    InputError,
    LatchedStopError,
    PortError,
    PortLostError,
    RefusedError,
    StoppedError,
)
from ikservo.kinematics.arrays import Vector
from ikservo.maintenance.dialogue import Progress
from ikservo.planning.reports import describe_alarms
from ikservo.remedies import in_page
from ikservo.serving.lease import ArmLease

_SETTLE_AFTER_S = 0.4  # a shorter pause does not end a drag
_POLL_PERIOD_S = 0.033  # poll period while no session runs
_STATE_PERIOD_S = 1.0
_TELEMETRY_PERIOD_S = 0.1  # period of taking telemetry from the control loop
_MAX_MESSAGES = 40
_CLOSED = StopReason(StopKind.CLOSED, "The panel was closed.")
_PLANNED_SILENCE_S = 2.5
"""Longest silence of the page, in seconds, that a planned and checked motion tolerates."""

_SILENCE_TEXT = (
    "Stopped, because the page does not answer; torque stays on. Switch Live on to continue."
)
_JOB_SILENCE_TEXT = "Stopped: the page does not answer, or draws no new picture."
_TORQUE_LOST_TEXT = (
    "{} lost torque without a command: a reset, a loss of supply, or another program. "
    "The button beside the joint switches it on again."
)
_REOPEN_TEXT = (
    "Check the cable and the power of the adapter, then continue: the port will be opened again."
)
_CHECK_FIRST_TEXT = "Check the arm, then continue."
_RESTART_TEXT = "Torque stays on. Close this arm in the list of arms, then open it again."


class ArmThread:
    """Thread that owns an arm; other threads post commands and read snapshots without waiting.

    Args:
        open_arm: Opens the arm, also after its port was lost.
        clock: The time of heartbeats; safe to read from any thread.
        dead_man_s: The time for which a command is valid without a heartbeat.
        calibration: Runs calibrations; None if the arm cannot be calibrated here.

    Attributes:
        lease: The page in control, and the time of its last heartbeat.
        arm: The arm; other threads may use only its constant parts. It is replaced after a
            calibration, and after its port was lost.
        snapshot: The last state of the arm; written by this thread alone.
        history: The measurements of the last ten minutes; written by this thread alone.
    """

    def __init__(
        self,
        open_arm: Callable[[], Arm],
        clock: Clock,
        dead_man_s: float = DEAD_MAN_TIMEOUT_S,
        calibration: CalibrationDriver | None = None,
    ) -> None:
        self._open, self._clock = open_arm, clock
        self.lease = ArmLease(clock, dead_man_s)
        self.calibration = calibration
        self.arm = open_arm()
        self._command = ArmCommand()
        self.snapshot = ArmSnapshot(np.zeros(0), np.zeros(0))
        self.snapshot = self._update_positions()
        self.arm.context.servos.warn = self.log_message
        self._states_s = self._telemetry_s = clock.now_s()
        joints = self.arm.model.joints
        self.history = History(
            [joint.name for joint in joints], [joint.joint_map.unit == "m" for joint in joints]
        )
        self._stop_reason: StopReason | None = None
        self._stops = self._shown_stops = 0  # requested, and confirmed by a calibration
        self._torque_requests: deque[tuple[str, bool]] = deque(maxlen=_MAX_MESSAGES)
        self._waiting_job: ArmJob | None = None
        self._running_job: ArmJob | None = None
        self._acknowledged = self._ending = self._lost = False
        self._thread = threading.Thread(target=self._run_thread, name="ikservo arm", daemon=True)

    def __enter__(self) -> ArmThread:
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Let the arm hold, end the thread and close the port."""
        self._ending = True
        self.request_stop(_CLOSED)
        self._thread.join()
        self.arm.close("hold")

    @property
    def command(self) -> ArmCommand:
        """The command that was posted last."""
        return self._command

    def post(self, command: ArmCommand) -> None:
        """Replace the command that the arm follows.

        This is the boundary between two threads: the server's thread posts, this thread reads
        ``command`` once per control cycle. A command is replaced as a whole, so neither thread
        waits or sees half of it. Only one thread may post, because a command is derived from its
        predecessor.
        """
        self._command = command

    def request_stop(self, reason: StopReason) -> None:
        """Brake and hold until acknowledged. Safe from any thread."""
        self._stop_reason, self._acknowledged, self._waiting_job = reason, False, None
        self._stops += 1
        self.arm.request_stop(reason)
        if self.calibration is not None:
            self.calibration.request_stop(reason)

    def acknowledge(self) -> None:
        """Acknowledge a stop: the arm may move again, but nothing moves yet."""
        self._acknowledged = True

    def request_torque(self, joint: str, *, on: bool) -> None:
        """Switch a joint's torque while no session runs. Safe from any thread."""
        self._torque_requests.append((joint, on))

    @property
    def job(self) -> ArmJob | None:
        """The running job, or the job that waits for the arm."""
        return self._running_job or self._waiting_job

    @property
    def moves_itself(self) -> bool:
        """Whether the arm has a job, or moves in a calibration."""
        return self.job is not None or (self.calibration is not None and self.calibration.holds)

    def request_job(self, job: ArmJob) -> None:
        """Request a job of the arm. Safe from any thread.

        Raises:
            InputError: The arm is busy, follows the page, or was stopped.
        """
        if self.snapshot.stop_notice or self._stop_reason is not None:
            raise InputError("The arm was stopped.", "Check it, then acknowledge.")
        if self.job is not None or self.snapshot.calibration:
            raise InputError("The arm is busy.", "Wait until it has finished, or stop it.")
        if self.command.live:
            raise InputError("The arm is following this page.", "Switch Live off first.")
        self._waiting_job = job

    def step(self) -> None:
        """Run one session until it ends, or poll the state once."""
        try:
            self._run_step()
        except (LatchedStopError, StoppedError) as error:
            if self._stop_reason is None:
                self._end_session(StopNotice(error.message, _CHECK_FIRST_TEXT))
            else:
                self._take_stop(self._stop_reason)
        except IkservoError as error:
            self._lost = self._lost or isinstance(error, PortLostError)
            message, hint = error.message, in_page(error.command_hint)
            if self._lost and isinstance(error, PortError):
                hint = _REOPEN_TEXT
            elif self.arm.context.servos.overheated:  # the guard lowered the arm, or tried to
                with contextlib.suppress(IkservoError):
                    self.snapshot = self._update_positions()
                message = describe_stop(message, self.snapshot.states)
            self._end_session(StopNotice(message, hint))

    def on_cycle(self, cycle: ControlCycle) -> None:
        """Store the positions of a cycle; poll telemetry once per second (``CycleObserver``)."""
        self.snapshot = replace(
            self.snapshot,
            measured=cycle.measured.copy(),
            read_s=self._clock.now_s(),
            reference=cycle.reference.copy(),
        )
        now_s = self._clock.now_s()
        self._take_telemetry(now_s)
        self._update_states(now_s)
        self._record_history()

    def _take_telemetry(self, now_s: float) -> None:
        """Take temperature, load and torque from the control loop."""
        if now_s - self._telemetry_s > _TELEMETRY_PERIOD_S:
            self._telemetry_s = now_s
            states = self.arm.context.servos.with_latest_telemetry(self.snapshot.states)
            self.snapshot = replace(self.snapshot, states=states)

    def _update_states(self, now_s: float) -> None:
        """Read the states of the servos once per second."""
        if now_s - self._states_s > _STATE_PERIOD_S:
            self._states_s = now_s
            with contextlib.suppress(BusError):  # the control cycle detects a lost port itself
                self.snapshot = replace(self.snapshot, states=self.arm.where().joints)

    def on_progress(self, progress: MotionProgress) -> None:
        """Store the positions of a job's motion; stop it if the page is silent."""
        now_s = self._clock.now_s()
        self.snapshot = replace(
            self.snapshot,
            measured=progress.joints_rad.copy(),
            read_s=now_s,
            reference=progress.setpoints_rad.copy(),
            activity=self._activity(progress.elapsed_s, progress.duration_s),
        )
        self._take_telemetry(now_s)
        self._record_history()
        self._require_heartbeat()

    def on_idle(self) -> None:
        """Read the arm at rest during a job; stop the job if the page is silent.

        Raises:
            RefusedError: The arm was stopped.
        """
        self._require_heartbeat()
        self.arm.context.servos.check_stop()
        now = self._update_positions()
        self.snapshot = replace(now, reference=None, activity=self._activity())
        self._record_history()

    def on_guided(self, measured: Vector) -> None:
        """Store joints (n,) of an arm that is guided by hand, which needs no heartbeat.

        Raises:
            RefusedError: The arm was stopped.
        """
        self.arm.context.servos.check_stop()
        now_s = self._clock.now_s()
        self.snapshot = replace(self.snapshot, measured=measured, read_s=now_s, reference=None)
        self._update_states(now_s)  # the control loop does not run, so its data are old
        self._record_history()

    def on_torque_off(self) -> None:
        """Read the arm after its torque was switched off on purpose."""
        self.snapshot = replace(self._update_positions(), reference=None)

    def reopen(self) -> None:
        """Open the arm again after a job has calibrated it."""
        self.arm.close("hold")
        self._lost = True  # until it is open again
        self._reopen_arm()

    def _require_heartbeat(self) -> None:
        """Stop the arm if the page is silent for longer than its job or calibration permits."""
        job, driver, limit_s = self._running_job, self.calibration, self.lease.timeout_s
        if (job and job.is_planned) or (driver and driver.arm is self.arm):  # with a camera
            limit_s = max(limit_s, _PLANNED_SILENCE_S)
        if self.lease.silence_s() > limit_s and self._stop_reason is None:
            self.request_stop(StopReason(StopKind.CLIENT, _JOB_SILENCE_TEXT))

    def _record_history(self) -> None:
        link = self.arm.context.servos.link_statistics()
        self.history.record(self.snapshot, link, self._clock.now_s())

    def on_refused(self, goal: Vector, error: RefusedError, kept: Vector) -> None:
        """Store a refused goal and log why (``CycleObserver``)."""
        refusal = replace(refusal_of(goal, error), kept=kept)
        self.snapshot = replace(self.snapshot, refusal=refusal)
        self.log_message(refusal.reason)

    def log_message(self, message: str, level: str = "bad") -> None:
        """Append a message for the user; a repetition only renews its time.

        An empty message is ignored. The level ``bad`` means a problem, an empty level information.
        """
        if not message:
            return
        entries = self.snapshot.messages
        if entries and entries[-1].message == message:
            entries = entries[:-1]
        entry = LogEntry(self._clock.now_s(), message, level)
        self.snapshot = replace(self.snapshot, messages=(*entries, entry)[-_MAX_MESSAGES:])

    def _run_thread(self) -> None:
        try:
            while not self._ending:
                self.step()
        except Exception as error:  # a bug: no thread controls the arm now, so report it
            self._end_session(StopNotice(f"The panel failed: {error!r}.", _RESTART_TEXT))
            raise

    def _run_step(self) -> None:
        if self._acknowledged:
            self._acknowledged, self._stop_reason = False, None
            if self._lost:
                self.arm.close("hold")
                self._reopen_arm()  # raises again if the port is still lost
            self.arm.acknowledge()
            self.snapshot = replace(self.snapshot, stop_notice=None)
        reason = self._stop_reason or self.arm.stop_reason  # set by the page, or by another program
        if reason is not None and not self.snapshot.stop_notice:
            self._take_stop(reason)
        if self.snapshot.stop_notice:
            self._torque_requests.clear()
            self._waiting_job = None
            self._poll_state(ignore_errors=True)
        elif self._torque_requests:
            joint, on = self._torque_requests.popleft()
            self.arm.runner.set_joint_torque(joint, on=on)
            self.snapshot = self._update_positions()  # must precede the check for lost torque
            self.log_message(
                f"Torque of {joint} switched {'on' if on else 'off'} from the page.", ""
            )
        elif self.calibration and self.calibration.requested:
            self._run_calibration(self.calibration)
        elif self._waiting_job is not None:
            self._run_job()
        elif self.command.live and self.command.session_id > self.snapshot.ended_session:
            self._run_session()
        else:
            self._poll_state()

    def _run_session(self) -> None:
        """Follow commands until Live ends, the speed changes, or heartbeats stop."""
        session = LiveSession(self, self.lease)
        self.arm.follow_goals(
            session,
            speed=session.speed,
            jerk_factor=HAND_JERK_FACTOR,
            settle_after_s=_SETTLE_AFTER_S,
            slow_s=HAND_SLOW_S,
            by_tip=lambda: self.command.by_tip,
        )
        if session.silent:
            self.log_message(_SILENCE_TEXT)
        if session.silent or session.is_over:  # Live may be on again since the arm braked
            self.snapshot = replace(self.snapshot, reference=None, ended_session=session.session_id)

    def _run_job(self) -> None:
        """Run the waiting job; as in a session, its errors stop the arm."""
        self._running_job, self._waiting_job = self._waiting_job, None
        if self._running_job is None:  # a stop came in between
            return
        self.snapshot = replace(self.snapshot, activity=self._activity())
        try:
            self._running_job.run(self.arm, self)
        finally:
            self._running_job = None
            self.snapshot = replace(self.snapshot, activity=None, reference=None)

    def _activity(self, elapsed_s: float = 0.0, duration_s: float = 0.0) -> Progress | None:
        """Return the running job, with the time of its present motion."""
        if self._running_job is None:
            return None
        total_s = duration_s if math.isfinite(duration_s) else 0.0
        return Progress(self._running_job.title, elapsed_s, total_s, elapsed_s)

    def _poll_state(self, *, ignore_errors: bool = False) -> None:
        """Read the arm's state while no session runs; log servos that lost torque by themselves."""
        try:
            before = self.snapshot.states
            self.snapshot = replace(self._update_positions(), reference=None)
            self._record_history()
            pairs = zip(before, self.snapshot.states, strict=True)
            lost = [now for then, now in pairs if then.torque and not now.torque]
            for names, alarms in describe_alarms(lost):
                self.log_message(f"Torque switched off by an alarm: {names}: {alarms}.")
            unexplained = [state.name for state in lost if not state.alarms]
            if unexplained:
                self.log_message(_TORQUE_LOST_TEXT.format(", ".join(unexplained)))
        except IkservoError:
            if not ignore_errors:
                raise
        self._clock.sleep_until(self._clock.now_s() + _POLL_PERIOD_S)

    def _take_stop(self, reason: StopReason) -> None:
        """End all activity at a stop; latch the stop unless the page has stopped a limp arm.

        Nothing moves or waits after that. With torque off there is nothing to check, so the user
        need not acknowledge the stop.
        """
        self._torque_requests.clear()
        is_read = False
        with contextlib.suppress(IkservoError):
            self.snapshot, is_read = self._update_positions(), True
        self.snapshot = replace(self.snapshot, stop_count=self.snapshot.stop_count + 1)
        text = describe_stop(reason.text, self.snapshot.states)
        is_limp = is_read and not any(state.torque for state in self.snapshot.states)
        if not is_limp or self._stop_reason is None:
            self._end_session(StopNotice(text, _CHECK_FIRST_TEXT))
            return
        self._stop_reason = None  # before the latch opens, so that a stop at this moment is kept
        self.arm.acknowledge()
        ended = self.command.session_id
        self.snapshot = replace(self.snapshot, reference=None, ended_session=ended)
        self.log_message(text, "")

    def _end_session(self, stop_notice: StopNotice) -> None:
        """End the session: the stop must be acknowledged and Live switched on again."""
        self.log_message(stop_notice.message)
        link = self.arm.context.servos.link_statistics()
        self.history.mark_stop(stop_notice.message, self.snapshot, link, self._clock.now_s())
        self.snapshot = replace(
            self.snapshot,
            stop_notice=stop_notice,
            reference=None,
            ended_session=self.command.session_id,
        )

    def _run_calibration(self, driver: CalibrationDriver) -> None:
        """Hand the port to the calibration, then reopen the arm."""
        joint_maps = [limits.joint_map for limits in self.arm.context.servos.driven_joints]
        picture = LimpPicture(joint_maps, self.snapshot.measured)
        with contextlib.ExitStack() as turns:
            try:
                turns.enter_context(self.arm.context.surroundings.in_turn())
            except RefusedError:
                driver.requested = False
                raise
            self.arm.close("hold")
            self._lost, self._shown_stops = True, self._stops
            driver.on_cycle, driver.log_message = self._on_calibration_cycle, self.log_message

            def open_calibrated() -> Arm:
                turns.close()  # the turn of the closed arm
                self._reopen_arm()
                turns.enter_context(self.arm.context.surroundings.in_turn())
                return self.arm

            driver.open_arm, driver.on_wait = open_calibrated, self._poll_state
            try:
                for calibration in driver.run():
                    self._show_calibration(driver, calibration, picture)
                    if self._ending:
                        return
            finally:
                self.snapshot = replace(self.snapshot, calibration=None)
                self.reopen()

    def _on_calibration_cycle(self, cycle: ControlCycle) -> None:
        """Store the positions in a calibration; stop the arm if the page is silent."""
        now_s, measured = self._clock.now_s(), cycle.measured.copy()
        self.snapshot = replace(self.snapshot, measured=measured, read_s=now_s)
        self._require_heartbeat()

    def _show_calibration(
        self, driver: CalibrationDriver, calibration: CalibrationView, picture: LimpPicture
    ) -> None:
        measured, states = self.snapshot.measured, self.snapshot.states
        if driver.arm is None:
            measured = picture.positions(calibration.request)
        if calibration.request is not None:
            states = tuple(replace(state, torque=driver.holds) for state in states)
        stops, self._shown_stops = self._stops - self._shown_stops, self._stops
        self.snapshot = replace(
            self.snapshot,
            calibration=calibration,
            stop_count=self.snapshot.stop_count + stops,
            measured=measured,
            states=states,
            read_s=self._clock.now_s(),
        )

    def _reopen_arm(self) -> None:
        """Open the arm again with the same things; it may have been calibrated meanwhile."""
        arm = self._open()
        arm.scene.take_over(self.arm.scene)
        self.arm = arm
        self.arm.context.servos.warn = self.log_message
        self._lost = False
        self.snapshot = self._update_positions()

    def _update_positions(self) -> ArmSnapshot:
        """Return the snapshot with present positions and telemetry of the servos."""
        states = self.arm.where().joints
        measured = np.array([state.position_rad for state in states])
        servos = self.arm.context.servos
        start = servos.reference() if servos.torque.is_on else measured
        now_s = self._clock.now_s()
        return replace(self.snapshot, measured=measured, start=start, read_s=now_s, states=states)
