"""Stop requests with their reasons, signal handlers, and stopping all servos where they are."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

from ikservo.clock import Clock
from ikservo.errors import IkservoError, RefusedError, StoppedError
from ikservo.guard import DrivenJoint, Gate, StopKind, StopReason
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.goal_writing import write_goals
from ikservo.registers import RegisterName

CTRL_C = StopReason(StopKind.CTRL_C, "Stopped; torque stays on.")
STOPPED_BY_PROGRAM = StopReason(StopKind.PROGRAM, "Stopped by the program.")
STOPPED_AFTER_REQUEST = StopReason(
    StopKind.PROGRAM, "The arm was stopped after this motion had been requested."
)
REQUEST_HINT = "Nothing was sent. Request it again once the arm may move."
RELAX_HINT = "Switch torque off with: ikservo relax"


class StopRequest:
    """A request to stop the arm: its reason and the number of requests.

    Signal handlers and threads may set the request, because setting it takes only a few
    assignments. The control loop checks it in every cycle. A stop also ends requests that have not
    moved the arm yet: ``requested`` marks the code of a request, and ``check_request`` raises an
    error in it.

    Attributes:
        times: The number of stop requests since the last one was acknowledged.
        acknowledged: Whether the stop was acknowledged before its motion ended.
        signal: The signal that made the first request; 0 if no signal did.
    """

    def __init__(self) -> None:
        self._reason: StopReason | None = None
        self.times = self.signal = self._count = 0
        self._requests = threading.local()
        self.acknowledged = self._motion_running = False
        self._without_braking, self._hint = False, RELAX_HINT

    def __bool__(self) -> bool:
        """Check whether a stop was requested."""
        return self.times > 0

    @property
    def reason(self) -> StopReason | None:
        """The reason for the first request; None if there was no request."""
        return self._reason

    @property
    def count(self) -> int:
        """The number of stops since the arm was opened, not counting cancelled motions."""
        return self._count

    @property
    def motion_running(self) -> bool:
        """Whether a motion is running, in one control loop or several; see ``motion``."""
        return self._motion_running

    def set(self, reason: StopReason, signal: int = 0) -> None:
        """Request the end of the motion, with the signal that caused it, if any."""
        self.signal = self.signal or signal
        self._reason = self._reason or reason
        self.acknowledged = False
        self.times += 1
        self.count_stop(reason)

    def count_stop(self, reason: StopReason) -> None:
        """Count a stop that ends earlier requests; cancelling a motion ends only that motion."""
        if reason.kind is not StopKind.CANCELLED:
            self._count += 1

    @contextmanager
    def requested(
        self,
        count: int | None = None,
        *,
        anew: bool = False,
        withdrawn: threading.Event | None = None,
    ) -> Generator[None]:
        """Mark the actions of this thread in the block as one request.

        ``count`` is the number of stops when the request was made, by default the present number;
        with ``anew``, the request is independent of the request that this thread is executing. Once
        the requester sets ``withdrawn``, planning ends as after a stop.
        """
        outer = self._marked
        if outer is not None and not anew:
            yield
            return
        self._requests.marked = (self.count if count is None else count, withdrawn)
        try:
            yield
        finally:
            self._requests.marked = outer

    @property
    def _marked(self) -> tuple[int, threading.Event | None] | None:
        return getattr(self._requests, "marked", None)

    @property
    def marked_count(self) -> int | None:
        """The ``count`` when this thread's present request was made; None if there is no mark."""
        return None if self._marked is None else self._marked[0]

    @property
    def count_at_request(self) -> int:
        """The ``count`` when this thread's present request was made; the present one by default."""
        marked = self.marked_count
        return self.count if marked is None else marked

    def is_request_over(self) -> bool:
        """Check whether this thread's request was withdrawn, or the arm was stopped since."""
        if self._marked is None:
            return False
        count, withdrawn = self._marked
        return count != self.count or (withdrawn is not None and withdrawn.is_set())

    def check_request(self) -> None:
        """Check that this thread's request was not withdrawn, and the arm was not stopped since.

        Raises:
            StoppedError: The arm was stopped, even if that has been acknowledged since.
        """
        if self.is_request_over():
            raise StoppedError((self._reason or STOPPED_AFTER_REQUEST).text, REQUEST_HINT)

    def set_without_braking(self, reason: StopReason, hint: str) -> None:
        """Request the immediate end of the motion, without sending anything more to the servos."""
        self._without_braking, self._hint = True, hint
        self.set(reason)

    @contextmanager
    def motion(self) -> Generator[None]:
        """Mark a motion as running within the block, in which a stop cannot be cleared."""
        before, self._motion_running = self._motion_running, True
        try:
            yield
        finally:
            self._motion_running = before

    def raise_if_without_braking(self) -> None:
        """Raise an error if the motion must end without braking.

        Raises:
            StoppedError: The motion must end; the error has the reason.
        """
        if self._without_braking:
            self.raise_if_set()

    def raise_if_set(self, hint: str = "") -> None:
        """Raise an error with a hint (by default the usual one) if a stop was requested.

        Raises:
            StoppedError: A stop was requested; the error has the reason.
        """
        if self:
            raise StoppedError((self._reason or STOPPED_BY_PROGRAM).text, hint or self._hint)

    def clear(self) -> None:
        """Clear the request, once the arm holds or may be moved again."""
        self._reason, self.times, self.signal = None, 0, 0
        self._without_braking, self._hint, self.acknowledged = False, RELAX_HINT, False


# A motion does not continue by itself after a longer pause of the program.
_MAX_PAUSE_S = 10.0


def check_pause(elapsed_s: float) -> None:
    """Refuse to continue after a pause in which a person may have approached the arm.

    Raises:
        RefusedError: The pause was too long.
    """
    if elapsed_s > _MAX_PAUSE_S:
        raise RefusedError(
            f"The program was delayed by {elapsed_s:.0f} s in the middle of a motion; "
            "torque stays on.",
            "Look at the arm, then move it again.",
        )


def fault_reason(error: BaseException) -> StopReason:
    """Return the reason for a stop that an error caused."""
    if isinstance(error, KeyboardInterrupt):
        return CTRL_C
    if isinstance(error, IkservoError):
        text = error.message
    elif isinstance(error, MemoryError):
        text = "The program ran out of memory during the motion."
    elif isinstance(error, (SystemExit, GeneratorExit)):
        text = "The program ended during the motion."
    else:
        found = f"{type(error).__name__}: {error}".removesuffix(": ")
        text = f"The program failed during the motion ({found})."
    return StopReason(StopKind.FAULT, text)


_REASONS = {
    "SIGINT": CTRL_C,
    "SIGTERM": StopReason(StopKind.TERMINATED, "Stopped by SIGTERM; torque stays on."),
    "SIGHUP": StopReason(
        StopKind.HANGUP, "Stopped because the terminal was closed; torque stays on."
    ),
}
_DEFAULTS = (signal.SIG_DFL, signal.default_int_handler)


def exit_exception(number: int, text: str) -> BaseException:
    """Return the exception that ends the program after a signal (decision 15).

    No ``except Exception`` or ``except IkservoError`` catches it, so that a program whose user
    pressed Ctrl-C does not go on to its next motion. The number of the signal is 0 if the program
    raised ``KeyboardInterrupt`` itself.
    """
    if number in (0, signal.SIGINT):
        return KeyboardInterrupt(text)
    return SystemExit(128 + number)  # a shell's exit code for a process that a signal ended


@contextmanager
def exiting_on_signals() -> Generator[None]:
    """Convert SIGTERM and SIGHUP to ``SystemExit`` within the block, so that cleanup runs.

    A motion in the block brakes first. In threads other than the main thread, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {n: signal.signal(n, _leave) for n in _signal_numbers() if n != signal.SIGINT}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _leave(number: int, _: FrameType | None) -> None:
    raise exit_exception(number, "")


_watched_stops: list[tuple[StopRequest, Callable[[], bool]]] = []


def stop_on_signals(stop_request: StopRequest, running: Callable[[], bool]) -> None:
    """On Ctrl-C, SIGTERM and SIGHUP, stop a motion that runs in another thread, and exit.

    Once no such motion runs, signals have their default effect again. The program's own handlers
    are kept; only the main thread can set handlers.
    """
    _watched_stops[:] = [each for each in _watched_stops if each[1]()]
    _watched_stops.append((stop_request, running))
    if threading.current_thread() is threading.main_thread():
        for number in _signal_numbers():
            if signal.getsignal(number) in _DEFAULTS:
                signal.signal(number, _on_signal)


def _on_signal(number: int, _: FrameType | None) -> None:
    if _request_watched(number):
        raise exit_exception(number, _reason_of(number).text)
    signal.signal(number, _DEFAULTS[number == signal.SIGINT])
    signal.raise_signal(number)


def _request_watched(number: int) -> bool:
    """Stop every background motion that is still running; return whether any was running."""
    requests = [request for request, running in _watched_stops if running()]
    for request in requests:
        request.set(_reason_of(number), number)
    return bool(requests)


def _reason_of(number: int) -> StopReason:
    return _REASONS[signal.Signals(number).name]


def _signal_numbers() -> list[int]:
    return [getattr(signal, name) for name in _REASONS if hasattr(signal, name)]


@contextmanager
def handle_signals(stop_request: StopRequest, loop_running: Callable[[], bool]) -> Generator[None]:
    """Convert Ctrl-C, SIGTERM and SIGHUP to a stop request within the block.

    If no control loop runs, the arm holds and ``KeyboardInterrupt`` is raised at once. The
    program's own handlers are kept. In threads other than the main thread, which receives all
    signals, nothing changes.
    """

    def request_stop(number: int, _: FrameType | None) -> None:
        stop_request.set(_reason_of(number), number)
        _request_watched(number)
        if not loop_running():
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours = (*_DEFAULTS, _on_signal, _leave)
    before = {n: signal.getsignal(n) for n in _signal_numbers() if signal.getsignal(n) in ours}
    try:
        for number in before:
            signal.signal(number, request_stop)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# A joint that moves by more than this in this time was moving. A resting joint keeps its goal,
# because its load has pulled it below: a goal at its position would let it sink more at every stop.
_POLL_PERIOD_S = 0.06
_MOVED_TICKS = 2
_ATTEMPTS = 3  # times that goals are sent and read back, because a sync write has no reply


@dataclass(frozen=True, slots=True)
class StopOutcome:
    """The outcome of a stop for each joint.

    Attributes:
        held: Joints that hold.
        limp: Joints without torque; their servos were not changed.
        silent: Joints that did not answer.
    """

    held: tuple[str, ...]
    limp: tuple[str, ...]
    silent: tuple[str, ...]


def hold_servos(bus: ServoBus, driven_joints: Sequence[DrivenJoint], clock: Clock) -> StopOutcome:
    """Hold every joint that has torque at its position; no torque is switched on or off."""
    ids = {driven.servo_id: driven for driven in driven_joints}
    torque = bus.sync_read(ids, RegisterName.TORQUE_ENABLE, raw=True).values
    on = [i for i in torque if bus.is_torque_on(i)]
    before = bus.sync_read(on, RegisterName.PRESENT_POSITION, raw=True).values
    clock.sleep_until(clock.now_s() + _POLL_PERIOD_S)
    present = bus.sync_read(on, RegisterName.PRESENT_POSITION, raw=True).values
    goals = bus.sync_read(on, RegisterName.GOAL_POSITION, raw=True).values
    moving: dict[int, int] = {}  # or about to move, because the goal is far ahead
    for i, tick in present.items():
        was, goal = before.get(i), goals.get(i)
        if (
            was is None
            or goal is None
            or abs(tick - was) > _MOVED_TICKS
            or abs(goal - tick) > ids[i].max_lead_ticks(0.0)
        ):
            moving[i] = tick
    _send_goals(bus, driven_joints, clock, moving)
    names = {i: driven.joint for i, driven in ids.items()}
    return StopOutcome(
        held=tuple(names[i] for i in present),
        limp=tuple(names[i] for i in torque if i not in on),
        silent=tuple(
            name for i, name in names.items() if i not in torque or (i in on and i not in present)
        ),
    )


def _send_goals(
    bus: ServoBus, driven_joints: Sequence[DrivenJoint], clock: Clock, ticks: Mapping[int, int]
) -> None:
    """Make servos hold their measured ticks, which are given by id."""
    ranges = {driven.servo_id: driven.tick_range for driven in driven_joints}
    pending = dict(ticks)
    for _ in range(_ATTEMPTS):  # a sync write has no reply, so goals are read back
        if pending:
            passed = Gate(driven_joints, clock).pass_reset([pending.get(i) for i in ranges]).ticks
            goals = {i: tick for i, tick in zip(ranges, passed, strict=True) if tick is not None}
            write_goals(bus, goals, ranges, reached=lambda servo_id: (ticks[servo_id],))
            found = bus.sync_read(pending, RegisterName.GOAL_POSITION, raw=True).values
            pending = {i: tick for i, tick in pending.items() if found.get(i) != tick}
