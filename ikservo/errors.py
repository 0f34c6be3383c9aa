"""All errors of ikservo, as one tree.

Each error states what was requested, what was found and what to do next, and also inherits from the
matching built-in error, so that ``except TimeoutError`` works for a silent servo::

    IkservoError                       exit 1
    ├── InputError        ValueError   exit 2   invalid user input
    │   ├── UnknownNameError LookupError        an unknown name
    │   ├── BadValueError                       a number or text that cannot be used
    │   └── FileFormatError                     a file; names the place and what was expected
    ├── PortError         OSError      exit 3   no port, no permission, busy, unplugged
    │   ├── NoPortError
    │   ├── PortBusyError
    │   └── PortLostError
    ├── BusError                       exit 4   wrong or missing replies on the bus
    │   ├── ServoSilentError TimeoutError
    │   ├── BadReplyError
    │   └── ServoRejectedError
    ├── ServoAlarmError                exit 5   a servo reports overload, temperature, voltage …
    ├── RegisterAccessError ValueError exit 1   a write that the register forbids
    ├── CalibrationError               exit 6   not calibrated, or contradicts the servos
    │   └── PictureError               exit 1   no picture, or one that cannot be used
    ├── UnreachableError  ValueError   exit 7   no joint vector inside the limits reaches the target
    │   ├── AimError                            the tip cannot point there
    │   ├── CartesianPathError                  the path cannot be followed; names the place
    │   └── OrientationError                    the point can be reached, but not the orientation
    ├── RefusedError                   exit 8   the guard does not allow a goal
    │   ├── BlockedError                        a path cannot be taken
    │   │   ├── CollisionError                  something would be touched
    │   │   └── ConstraintError                 the tool would tilt, or leave its region
    │   ├── LatchedStopError                    the arm was stopped; not acknowledged yet
    │   └── LeaseLostError                      another program controls the arm
    ├── NotSettledError   TimeoutError exit 1   the arm did not arrive
    └── StoppedError                   exit 130 stopped by the user
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable, Sequence
from enum import IntEnum
from pathlib import Path

from ikservo.remedies import in_python


class ExitCode(IntEnum):
    """Exit codes of the command line; printed by ``ikservo --help``."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    PORT = 3
    SILENT = 4
    ALARM = 5
    CALIBRATION = 6
    UNREACHABLE = 7
    REFUSED = 8
    STOPPED = 130

    @property
    def meaning(self) -> str:
        """The text that ``--help`` prints beside the number."""
        return _MEANINGS[self]


_MEANINGS = {
    ExitCode.DONE: "done",
    ExitCode.FAILED: "failed",
    ExitCode.USAGE: "usage",
    ExitCode.PORT: "no port or no permission",
    ExitCode.SILENT: "servo silent",
    ExitCode.ALARM: "servo alarm",
    ExitCode.CALIBRATION: "not calibrated, or servos differ from the calibration",
    ExitCode.UNREACHABLE: "unreachable",
    ExitCode.REFUSED: "refused by the guard",
    ExitCode.STOPPED: "stopped by the user",
}


# Control characters except tab and new line, characters that reverse the text direction, and
# halves of surrogate pairs, which cannot be encoded.
CONTROL = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)
_MAX_MESSAGE_CHARS = 8000  # the longest useful message lists the mistakes of a long file
_MAX_SHOWN_CHARS = 200


def printable(text: str) -> str:
    """Escape control characters, which could come from a file or the network.

    On a terminal they could move the cursor, hide what was printed, or type an answer.
    """
    return CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)


def shown(value: object, write: Callable[[object], str] = repr) -> str:
    """Return the text of any value, shortened; never raises."""
    try:
        text = write(value)
    except Exception:  # nested too deeply, too many digits, or an error in a class of the user
        return f"a value of type {type(value).__name__}"
    return _cut(text, _MAX_SHOWN_CHARS)


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[:most]}…"


class IkservoError(Exception):
    """Base of all errors of ikservo; ``str`` of each is bounded and printable.

    Attributes:
        command_message: One line that says what happened, in terms of the command line.
        command_hint: The remedy, in terms of the command line; may be empty.
        python_hint: The remedy for a mistake that only a program can make; may be empty.
        exit_code: The exit code of the command line.
    """

    exit_code: ExitCode = ExitCode.FAILED

    def __init__(self, message: str, hint: str = "") -> None:
        message, hint = (_cut(each, _MAX_MESSAGE_CHARS) for each in (message, hint))
        super().__init__(printable(in_python(message)))
        self.command_message = message
        self.command_hint = hint
        self.python_hint = ""

    @property
    def message(self) -> str:
        """One line that says what happened, in terms of the Python interface."""
        return in_python(self.command_message)

    @property
    def hint(self) -> str:
        """The remedy in terms of the Python interface, such as ``arm.relax()``; may be empty."""
        return self.python_hint or in_python(self.command_hint)

    def __str__(self) -> str:
        return printable(f"{self.message}\n{self.hint}" if self.hint else self.message)


class InputError(IkservoError, ValueError):
    """The user's input cannot be used."""

    exit_code = ExitCode.USAGE


class UnknownNameError(InputError, LookupError):
    """A name is unknown; the closest known name is suggested."""

    def __init__(self, kind: str, name: object, known: Iterable[str]) -> None:
        self.kind, self.name, self.known = kind, name, sorted(known)
        close = difflib.get_close_matches(shown(name, str).lower(), self.known, n=1)
        self.closest = close[0] if close else None
        listing = ", ".join(self.known) or "none"
        hint = f"Did you mean {self.closest}? " if self.closest else ""
        super().__init__(f"There is no {kind} named {shown(name)}.", f"{hint}Known: {listing}.")


class BadValueError(InputError):
    """A number or text cannot be used; the message says what was expected."""

    def __init__(self, what: str, found: object, expected: str) -> None:
        self.what, self.found, self.expected = what, found, expected
        text = found if isinstance(found, str) else shown(found, str)
        super().__init__(f"{what} is {text}.", f"Expected {expected}.")


class FileFormatError(InputError):
    """A file cannot be used; the message says where, what was found and what was expected."""

    def __init__(self, path: Path | str, where: str, found: str, expected: str = "") -> None:
        self.path, self.where, self.found, self.expected = Path(path), where, found, expected
        place = f"{path}, {where}" if where else str(path)
        super().__init__(f"{place}: {found}.", f"Expected {expected}." if expected else "")


class PortError(IkservoError, OSError):
    """The serial port cannot be used."""

    exit_code = ExitCode.PORT

    def __init__(self, message: str, hint: str = "") -> None:
        IkservoError.__init__(self, message, hint)


class NoPortError(PortError):
    """The port does not exist, or was not given and cannot be chosen; existing ports are listed."""

    def __init__(self, name: str, found: Iterable[str] = (), why: str = "") -> None:
        self.name, self.found, self.why = name, list(found), why
        listing = ", ".join(self.found) or "none"
        reason = why.rstrip(".") or "it does not exist"
        none = "and no USB adapter found" if not self.found else ""
        given = f"No serial port given{': ' if why else ' '}{why.rstrip('.') or none}".rstrip()
        message = f"Cannot open port {name}: {reason}." if name else f"{given}."
        choose = "Choose one with --port. " if not name and len(self.found) > 1 else ""
        super().__init__(message, f"{choose}Ports found: {listing}. Without an arm: --port sim")


class PortBusyError(PortError):
    """Another process uses the port; it is named if the system reports it."""

    def __init__(self, name: str, holder: str = "") -> None:
        self.name, self.holder = name, holder
        by = f" by {holder}" if holder else ""
        super().__init__(
            f"Port {name} is in use{by}.",
            "End that program and try again. Two arms on one adapter must be opened by one "
            "program.",
        )


class PortLostError(PortError):
    """The port was lost: unplugged, or its server ended."""

    def __init__(self, name: str, why: str = "") -> None:
        self.name, self.why = name, why
        super().__init__(
            f"Lost connection to {name}: {why or 'device unplugged'}.",
            "Check the cable and the power of the adapter, then start again.",
        )


class BusError(IkservoError):
    """Wrong or missing replies on the bus.

    Attributes:
        servo: Joint name and id, for example ``elbow_flex (id 3)``.
        servo_id: The id alone, if the error concerns one servo.
        port: The port's name.
        request: The request to the servo.
        found: The fault, as a predicate of the servo's name: "does not answer".
        sent: The bytes of the request, for bug reports.
        received: The bytes that came back.
    """

    exit_code = ExitCode.SILENT
    _usual_hint = ""

    def __init__(
        self,
        found: str,
        hint: str = "",
        *,
        servo: str = "",
        servo_id: int | None = None,
        port: str = "",
        request: str = "",
        sent: bytes = b"",
        received: bytes = b"",
    ) -> None:
        self.servo, self.servo_id, self.port, self.request = servo, servo_id, port, request
        self.found, self.sent, self.received = found, sent, received
        place = f"{servo} on {port}" if servo and port else servo or port
        purpose = f" when asked to {request}" if request else ""
        subject = f"{place} " if place else ""
        super().__init__(f"{subject}{found}{purpose}.", hint or self._usual_hint)

    @property
    def detail(self) -> str:
        """The bytes of request and reply in hex, for a bug report."""
        if not self.sent:
            return ""
        received = self.received.hex(" ").upper() or "nothing"
        return f"Sent {self.sent.hex(' ').upper()}, received {received}."

    def __str__(self) -> str:
        return "\n".join(filter(None, (super().__str__(), self.detail)))


class ServoSilentError(BusError, TimeoutError):
    """No status packet from a servo within the reply timeout."""

    _usual_hint = "Check its power, the cable that leads to it, its id and the baud rate."


class BadReplyError(BusError):
    """A status packet has a wrong checksum, length or id."""

    _usual_hint = "Check for loose plugs, two servos with one id, and another program on the port."


class ServoRejectedError(BusError):
    """A servo refused a request."""


class ServoAlarmError(IkservoError):
    """A servo reports overload, overheating, wrong voltage or a broken encoder."""

    exit_code = ExitCode.ALARM


class RegisterAccessError(IkservoError, ValueError):
    """A register cannot be written: it is read-only, out of range, or in EEPROM under torque.

    Attributes:
        servo: Joint name and id.
        register: The register's name.
        reason: Why the register cannot be written.
    """

    def __init__(self, servo: str, register: str, reason: str, hint: str = "") -> None:
        self.servo, self.register, self.reason = servo, register, reason
        super().__init__(
            f"{register} of {servo} cannot be written: {reason}.", hint or "Nothing was sent."
        )


class CalibrationError(IkservoError):
    """The arm is not calibrated, or its calibration contradicts the servos."""

    exit_code = ExitCode.CALIBRATION


class PictureError(CalibrationError):
    """A camera delivers no picture, or a picture that is unusable because the board is missing."""

    exit_code = ExitCode.FAILED


class UnreachableError(IkservoError, ValueError):
    """No joint vector inside the limits brings the tool to the target.

    Attributes:
        target_m: The target position, metres, arm's base frame.
        nearest_m: The closest position found, same frame.
        binding: The active limits.
        instead_m: A nearby point in whole millimetres, checked to be reachable.
    """

    exit_code = ExitCode.UNREACHABLE

    def __init__(
        self,
        target_m: Sequence[float],
        nearest_m: Sequence[float],
        binding: Sequence[str] = (),
        instead_m: Sequence[float] | None = None,
    ) -> None:
        self.target_m, self.nearest_m = tuple(target_m), tuple(nearest_m)
        self.binding, self.instead_m = tuple(binding), instead_m and tuple(instead_m)
        gap_m = math.dist(target_m, nearest_m)
        held = f" ({', '.join(self.binding)})" if self.binding else ""
        coordinates = "" if instead_m is None else " ".join(f"{x:z.3f}" for x in instead_m)
        super().__init__(
            f"{format_point(target_m)} cannot be reached{held}.",
            f"Nearest reachable point: {format_point(nearest_m)}, {gap_m * 1000:.1f} mm away."
            + (f" Try: ikservo move {coordinates}" if coordinates else ""),
        )


class CartesianPathError(UnreachableError):
    """A path of the tool cannot be followed to its end without a jump of the joints.

    Attributes:
        along_m: The distance along the path at which it fails.
        shape: The kind of path, such as line or arc.
    """

    def __init__(
        self,
        along_m: float,
        target_m: Sequence[float],
        nearest_m: Sequence[float],
        binding: Sequence[str] = (),
        shape: str = "line",
    ) -> None:
        super().__init__(target_m, nearest_m, binding)
        self.along_m, self.shape = along_m, shape
        self.command_message = (
            f"The {shape} can be followed only for {along_m:.3f} m, to "
            f"{format_point(target_m)} ({', '.join(binding)})."
        )
        other = "move there without --line" if shape == "line" else f"a smaller {shape}"
        self.command_hint = f"Nothing moved. Choose a nearer end, or {other}."


class OrientationError(UnreachableError):
    """The point can be reached, but not in the requested orientation.

    Attributes:
        asked: The requested orientation, as text.
        instead: The closest possible orientation, as text.
        left_rad: The angle between the requested and the closest possible orientation.
        freedom: The joint that the arm would need in addition, as text; empty if none is missing.
    """

    def __init__(
        self,
        position_m: Sequence[float],
        asked: str,
        instead: str,
        left_rad: float,
        binding: Sequence[str] = (),
        freedom: str = "",
    ) -> None:
        super().__init__(position_m, position_m, binding)
        self.asked, self.instead, self.left_rad = asked, instead, left_rad
        self.freedom = freedom
        held = f" ({', '.join(self.binding)})" if self.binding else ""
        self.command_message = (
            f"{asked} is not possible at {format_point(position_m)}; "
            f"the closest is {math.degrees(left_rad):.1f}° off{held}."
        )
        self.command_hint = (
            f"Nothing moved. {freedom} Closest orientation there: {instead}.".replace("  ", " ")
        )


class AimError(UnreachableError):
    """No joint vector inside the limits points the tip at the target.

    Attributes:
        left_rad: The angle that remains between the tip's axis and the direction to the point.
    """

    def __init__(
        self, point_m: Sequence[float], left_rad: float, binding: Sequence[str] = ()
    ) -> None:
        super().__init__(point_m, point_m, binding)
        self.left_rad = left_rad
        held = f" ({', '.join(self.binding)})" if self.binding else ""
        self.command_message = (
            f"The tip cannot point at {format_point(point_m)}; "
            f"the closest is {math.degrees(left_rad):.1f}° off{held}."
        )
        self.command_hint = "Nothing moved. Choose another point."


class RefusedError(IkservoError):
    """The guard does not allow a goal; nothing was sent."""

    exit_code = ExitCode.REFUSED


class BlockedError(RefusedError):
    """A path cannot be taken, though another path may be possible; nothing was sent.

    Attributes:
        cause: The reason, without the place on the path.
    """

    def __init__(self, cause: str, message: str, hint: str) -> None:
        self.cause = cause
        super().__init__(message, hint)


class CollisionError(BlockedError):
    """The path to a goal would lead to a collision; nothing was sent.

    Attributes:
        pair: The colliding link, and the other link or the thing that it touches, by name.
    """

    def __init__(self, pair: tuple[str, str], depth_m: float, fraction: float) -> None:
        self.pair = pair
        cause = f"{pair[0]} would touch {pair[1]}"
        percent = round(100.0 * fraction)
        where = "inside it at the goal" if percent == 100 else f"deep, at {percent} % of the path"
        hint = "Choose another target, move via another pose, or correct the obstacles."
        super().__init__(cause, f"{cause}: {depth_m * 1e3:.1f} mm {where}.", hint)


class ConstraintError(BlockedError):
    """The tool would violate a constraint on its path; nothing was sent.

    Attributes:
        beyond: Excess over the allowed value, rad or m.
    """

    def __init__(self, what: str, most: float, beyond: float, unit: str, fraction: float) -> None:
        self.beyond = beyond
        if unit == "°":
            found, allowed = math.degrees(most + beyond), math.degrees(most)
            cause = f"{what} would be {found:.1f}°, more than the allowed {allowed:.1f}°"
        else:
            cause = f"the tip would be {beyond * 1e3:.1f} mm outside the {what}"
        message = f"{cause}, at {fraction * 100:.0f} % of the path."
        hint = "Nothing was sent. Widen the limit, or choose another target or path."
        super().__init__(cause, message[0].upper() + message[1:], hint)


class HeldUpError(RefusedError):
    """The program was delayed in a motion for so long that the servos' watchdogs stopped them."""


class LatchedStopError(RefusedError):
    """The arm was stopped, and the stop is not acknowledged yet."""

    def __init__(self, reason: str) -> None:
        super().__init__(
            f"The arm was stopped: {reason}", "Check the arm, then acknowledge the stop."
        )


class LeaseLostError(RefusedError):
    """The program does not control the arm, or no longer does; nothing was sent."""

    def __init__(self) -> None:
        super().__init__(
            "This program does not control the arm, or no longer does.",
            "Nothing was sent. Look at the arm, then try again.",
        )


class NotSettledError(IkservoError, TimeoutError):
    """The arm did not come to rest near its goal in time.

    Attributes:
        result: The report of the motion, as ``move_to`` or ``move_joints`` return it; None if the
            motion has not ended.
    """

    def __init__(self, message: str, hint: str = "", result: object = None) -> None:
        super().__init__(message, hint)
        self.result = result


class StoppedError(IkservoError):
    """The user stopped the motion; the arm holds."""

    exit_code = ExitCode.STOPPED


def format_point(point_m: Iterable[float]) -> str:
    """Format a point (3,) [m] as ``(0.250, 0.050, 0.150) m``."""
    return f"({', '.join(f'{float(x):z.3f}' for x in point_m)}) m"
