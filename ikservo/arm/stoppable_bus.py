"""A bus through which the user's other programs can stop the program that uses it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from ikservo.control.stop_requests import REQUEST_HINT
from ikservo.errors import PortBusyError, StoppedError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.port_names import is_simulated

if TYPE_CHECKING:
    from ikservo.arm.control_server import ControlServer, RequestHandler
    from ikservo.serving.control_client import Request

_EARLY = "Stopped from another terminal before the port was opened."
_STOPPED = "Stopped from another terminal."


def stoppable(bus: ServoBus, arm: str = "") -> ServoBus:
    """Let the user's other programs stop this program while it uses a bus; return the bus."""
    bus.stop_listener = StopListener(bus, arm)
    return bus


class StopListener:
    """Receiver of stops for a bus from other programs; see ``stoppable``.

    After a stop, torque cannot be switched on. Once an ``Arm`` uses the bus, this arm handles the
    requests. The simulated bus of this process has no socket, because no other program can find it.

    Args:
        bus: The bus.
        arm: The name of the arm; empty if the servos belong to no arm.
    """

    def __init__(self, bus: ServoBus, arm: str) -> None:
        self._bus, self._arm, self._stop_text = bus, arm, ""
        self._arm_handler: RequestHandler | None = None
        self._turn = threading.Lock()
        self._server: ControlServer | None = None
        if not is_simulated(bus.port.name):
            from ikservo.arm.control_server import serve  # noqa: PLC0415  # only for real ports
            from ikservo.serving.early_stops import has_mark  # noqa: PLC0415

            self._server = serve(bus.port.name, self._handle, arm)
            if has_mark(bus.port.name, arm):
                self._stop_text = _EARLY

    @property
    def is_served(self) -> bool:
        """Whether other programs of this user can reach this one."""
        return self._server is not None

    def hand_over(self, handler: RequestHandler) -> str:
        """Let an arm handle all further requests; return the reason for an earlier stop, if any."""
        with self._turn:
            self._arm_handler = handler
            text, self._stop_text = self._stop_text, ""
        return text

    def check_may_move(self) -> None:
        """Check that no other program has stopped this one.

        Raises:
            StoppedError: Another program has stopped this one.
        """
        if self._stop_text:
            raise StoppedError(self._stop_text, REQUEST_HINT)

    def close(self) -> None:
        """Stop listening; the port stays open."""
        if self._server is not None:
            self._server.close()
            self._server = None
            if not self._stop_text:  # an arm that is opened next must know of a stop
                from ikservo.serving.early_stops import forget_marks  # noqa: PLC0415

                forget_marks()

    def _handle(self, request: Request) -> object:
        with self._turn:
            if self._arm_handler is None:
                return self._handle_alone(request)
        return self._arm_handler(request)

    def _handle_alone(self, request: Request) -> object:
        from ikservo.arm.result_json import encode_value  # noqa: PLC0415
        from ikservo.serving.control_client import ControlCommand, StopResult  # noqa: PLC0415

        match request.do:
            case ControlCommand.WHO:
                return {"arm": self._arm, "port": self._bus.port.name}
            case ControlCommand.STOP:
                self._stop_text = _STOPPED
                on = (
                    servo for servo in self._bus.servos.values() if self._bus.is_torque_on(servo.id)
                )
                held = tuple(dict.fromkeys(servo.name or str(servo.id) for servo in on))
                arm = self._arm or "an arm that is being set up"
                return encode_value(StopResult(arm, self._bus.port.name, bool(held), held, (), ()))
            case ControlCommand.WHERE | ControlCommand.RELAX:
                raise PortBusyError(
                    self._bus.port.name, "a program that sets up or calibrates servos"
                )
