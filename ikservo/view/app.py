"""The view application: open the arm, start the arm thread and the web server."""

from __future__ import annotations

import contextlib
import gc
import ipaddress
import sys
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from ikservo.arm import DEAD_MAN_TIMEOUT_S, Arm, open_arm
from ikservo.clock import RealClock
from ikservo.errors import BadValueError
from ikservo.hardware.remembered_port import is_simulated
from ikservo.model import Model
from ikservo.view.arm_thread import ArmThread
from ikservo.view.auth import AccessTokens
from ikservo.view.calibration import CalibrationDriver
from ikservo.view.controller import SessionController
from ikservo.view.server import BoundAddress, make_app, serve, serve_in_thread

__all__ = ["ViewApp", "ViewUrls", "low_jitter", "real_time_port"]


# The control loop must not wait long for the drawing thread, nor the page for either.
_SWITCH_S = 0.0005


@contextmanager
def low_jitter() -> Generator[None]:
    """Switch threads often, and exclude loaded modules from garbage collection.

    A full collection over all that pydantic has loaded takes a tenth of a second, in which no
    thread runs; frozen objects are not visited again.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


@dataclass(frozen=True, slots=True)
class ViewUrls:
    """URLs of the page.

    Attributes:
        control: With the key that permits moving the arm.
        watch: With the key that permits watching.
        warnings: Warnings about the address.
    """

    control: str
    watch: str
    warnings: tuple[str, ...] = ()


class ViewApp:
    """A view of one arm; entering opens the arm, leaving lets it hold.

    Args:
        model: The arm.
        port: Its port; a simulated one runs in real time.
        listen: The IP address at which the page is served.
        http: The port of the page, 0 for any that is free.
        collisions: See ``open_arm``.
        uncalibrated: See ``open_arm``.
        dead_man_s: How long the arm follows without a heartbeat of the page.
    """

    def __init__(
        self,
        model: Model,
        port: str | None,
        listen: str = "127.0.0.1",
        http: int = 0,
        *,
        collisions: bool = True,
        uncalibrated: bool = False,
        dead_man_s: float = DEAD_MAN_TIMEOUT_S,
    ) -> None:
        self._model, self._port = model, real_time_port(port)
        self._listen, self._http = _check_address(listen), http
        self._collisions, self._uncalibrated = collisions, uncalibrated
        self._dead_man_s = dead_man_s
        self.keys = AccessTokens.generate()
        self._exits = ExitStack()

    def __enter__(self) -> ViewUrls:
        """Open the arm and the address.

        Raises:
            IkservoError: The arm or the address cannot be opened.
        """
        with ExitStack() as stack:
            self._address = BoundAddress(self._listen, self._http)
            stack.callback(self._address.socket.close)
            clock = RealClock()
            calibration = CalibrationDriver(self._model, self._port)
            self.arm_thread = stack.enter_context(
                ArmThread(self._open_arm, clock, self._dead_man_s, calibration)
            )
            self.controller = SessionController(self.arm_thread, clock)
            stack.callback(self.controller.close)
            self._app = make_app(self.controller, self.keys, clock)
            stack.enter_context(low_jitter())
            self._exits = stack.pop_all()
        url = self._address.url
        return ViewUrls(f"{url}/#token={self.keys.control}", f"{url}/#token={self.keys.watch}",
                    tuple(self._collect_warnings()))  # fmt: skip

    def __exit__(self, *_: object) -> None:
        """Let the arm hold and close everything."""
        self._exits.close()

    def serve(self) -> None:
        """Serve in this thread, the main one, until Ctrl-C."""
        serve(self._app, self._address)

    def serve_in_thread(self) -> ExitStack:
        """Serve in a separate thread until the stack is closed, for a program that goes on."""
        stack = ExitStack()
        stack.enter_context(serve_in_thread(self._app, self._address))
        return stack

    def _open_arm(self) -> Arm:
        return open_arm(self._model, self._port, collisions=self._collisions,
                        uncalibrated=self._uncalibrated)  # fmt: skip

    def _collect_warnings(self) -> list[str]:
        if ipaddress.ip_address(self._listen).is_loopback:
            return []
        return [
            "The network can reach this page. Its key never travels over the wire, but what is "
            "said does so unencrypted; from afar rather use: ssh -L 8420:localhost:8420 HOST"
        ]


def real_time_port(port: str | None) -> str | None:
    """Return the port; a simulated one is set to run in real time."""
    if port is None or not is_simulated(port) or "paced=" in port:
        return port
    return f"{port if ':' in port else port + ':'}{'&' if '?' in port else '?'}paced=1"


def _check_address(listen: str) -> str:
    """Return the address if it is a single one; a browser cannot open a wildcard address."""
    with contextlib.suppress(ValueError):
        address = ipaddress.ip_address(listen)
        if not address.is_unspecified:
            return str(address)
    expected = "one IP address of this machine, such as 127.0.0.1"
    raise BadValueError("--listen", repr(listen), expected)
