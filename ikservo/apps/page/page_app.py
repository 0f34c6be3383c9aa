"""The panel application: open the arms, start their threads and the web server."""

from __future__ import annotations

import contextlib
import gc
import ipaddress
import os
import sys
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ikservo.apps.page.arm_choices import ChoiceFinder
from ikservo.apps.page.arm_list import ArmList, read_arm_list_message
from ikservo.apps.page.messages.page_messages import read_message
from ikservo.apps.page.panels.dialogue_panel import DialoguePanel
from ikservo.apps.page.panels.episode_panel import EpisodeFolder
from ikservo.apps.page.panels.page_cameras import PageCameras
from ikservo.apps.page.panels.servo_bench import ServoBench, read_bench_message
from ikservo.apps.page.served_arms import ArmAtPort, ServedArms, ViewSettings
from ikservo.apps.page.server.auth import AccessTokens
from ikservo.apps.page.server.downloads import DownloadOffers
from ikservo.apps.page.server.server import (
    USUAL_PORT,
    BoundAddress,
    PageChannel,
    make_app,
    serve,
    serve_in_thread,
)
from ikservo.arm import DEAD_MAN_TIMEOUT_S, Arm
from ikservo.arm.opening import open_own_arm
from ikservo.clock import RealClock
from ikservo.errors import BadValueError, shown
from ikservo.hardware.transport import refuse_other_machines
from ikservo.model import Model

# The control loop must not wait long for the drawing thread, nor the page for either.
_SWITCH_S = 0.0005


@contextmanager
def low_jitter() -> Generator[None]:
    """Switch threads often, and exclude loaded modules from garbage collection.

    A full collection over all pydantic objects takes a tenth of a second, in which no thread runs;
    frozen objects are not visited again.
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
        control: The URL with the key that permits moving the arm.
        watch: The URL with the key that permits watching.
        fingerprint: SHA-256 of the server's certificate; empty for plain HTTP.
        warnings: Warnings about the address.
    """

    control: str
    watch: str
    fingerprint: str = ""
    warnings: tuple[str, ...] = ()


class ViewApp:
    """The panel for several arms. Entering it opens the given arms; on leaving, all arms hold.

    Args:
        places: The arms and their ports; simulated arms run in real time. It may be empty, because
            arms can also be opened on the page.
        listen: The IP address at which the page is served.
        http: See ``BoundAddress``.
        insecure: Serve other machines by plain HTTP instead of TLS.
        collisions: See ``open_arm``.
        uncalibrated: See ``open_arm``.
        dead_man_s: The time for which the arm follows without a heartbeat of the page.
        cameras: See ``PageCameras``.
        camera_name: See ``PageCameras``.
        servos: The port of the servos that the page shows instead of arms, and their arm.
        offered_port: A port that the list of arms offers in addition to the ports that it finds.
        record: See ``ViewSettings``.
    """

    def __init__(
        self,
        places: Sequence[ArmAtPort],
        listen: str = "127.0.0.1",
        http: int | None = 0,
        *,
        insecure: bool = False,
        collisions: bool = True,
        uncalibrated: bool = False,
        dead_man_s: float = DEAD_MAN_TIMEOUT_S,
        cameras: Sequence[str] = (),
        camera_name: str = "",
        servos: tuple[str, Model | None] | None = None,
        offered_port: str | None = None,
        record: EpisodeFolder | None = None,
    ) -> None:
        ports = [place.port or os.environ.get("IKSERVO_PORT", "") for place in places]
        for port in [*ports, *(servos or ())[:1], offered_port or ""]:
            refuse_other_machines(port)
        self._servos, self._offered_port = servos, offered_port
        self._places = places
        self._listen, self._http = _check_address(listen), http
        self._is_local = ipaddress.ip_address(self._listen).is_loopback
        self._uses_tls = not (self._is_local or insecure)
        self._collisions, self._uncalibrated = collisions, uncalibrated
        self._dead_man_s, self._cameras, self._camera_name = dead_man_s, cameras, camera_name
        self._record = record
        self.keys = AccessTokens.generate()
        self._exits = ExitStack()

    def __enter__(self) -> ViewUrls:
        """Open the arms and the address; an arm that cannot be opened does not affect other arms.

        Raises:
            IkservoError: None of the arms can be opened, or the address cannot be used.
        """
        certificate = None
        if self._uses_tls:
            from ikservo.apps.page.server.certificate import load_or_make_certificate  # noqa: PLC0415  # seldom

            certificate = load_or_make_certificate(self._listen)
        with ExitStack() as stack:
            self._address = BoundAddress(self._listen, self._http, certificate)
            stack.callback(self._address.socket.close)
            clock = RealClock()
            cameras = stack.enter_context(PageCameras(clock, self._cameras, self._camera_name))
            downloads = DownloadOffers(clock)
            self.arms = ServedArms(
                ViewSettings(
                    self._open_arm, clock, downloads, self._dead_man_s, cameras, self._record
                )
            )
            stack.callback(self.arms.close)
            self.arms.open_all(self._places)
            self._require_camera()
            if self._servos is not None:
                self._bench = ServoBench(*self._servos, downloads)
                stack.callback(self._bench.close)
            dialogues = DialoguePanel(Path.cwd(), is_local=self._is_local)
            stack.callback(dialogues.close)
            choices = ChoiceFinder(self._places, self._offered_port)
            arm_list = ArmList(self.arms, choices, clock, downloads, dialogues)
            index = "index.html" if self._servos is None else "servos.html"
            self._app = make_app(self._channels(arm_list), self.keys, clock, downloads, index)
            stack.enter_context(low_jitter())
            self._exits = stack.pop_all()
        url = self._address.url
        return ViewUrls(
            f"{url}/#token={self.keys.control}",
            f"{url}/#token={self.keys.watch}",
            "" if certificate is None else certificate.fingerprint,
            tuple(self._collect_warnings(cameras)),
        )

    def __exit__(self, *_: object) -> None:
        """Let the arms hold and close everything."""
        self._exits.close()

    def serve(self) -> None:
        """Serve in this thread, the main one, until Ctrl-C."""
        serve(self._app, self._address)

    def serve_in_thread(self) -> ExitStack:
        """Serve in a separate thread until the stack is closed, so that the program continues."""
        stack = ExitStack()
        stack.enter_context(serve_in_thread(self._app, self._address))
        return stack

    def _channels(self, arm_list: ArmList) -> list[PageChannel[Any]]:
        """Return the websockets: one for each arm, and one for the list of arms.

        A page of servos has neither; it opens only its own port.
        """
        if self._servos is not None:
            return [PageChannel("/bench", lambda _: self._bench, read_bench_message)]
        return [
            PageChannel("/live", self.arms.find, read_message),
            PageChannel("/arms", lambda arm: None if arm else arm_list, read_arm_list_message),
        ]

    def _open_arm(self, model: Model, port: str | None) -> Arm:
        return open_own_arm(model, port, collisions=self._collisions,
                            uncalibrated=self._uncalibrated)  # fmt: skip

    def _require_camera(self) -> None:
        """Check that one of the open arms shows a picture, if a camera was requested."""
        arms = [arm for arm in self.arms.all() if arm.is_open]
        if not any(arm.video for arm in arms):
            for arm in arms:
                if arm.camera_error is not None:
                    raise arm.camera_error

    def _collect_warnings(self, cameras: PageCameras) -> list[str]:
        missing = [_NO_CAMERA_TEXT.format(name) for name in cameras.find_missing()]
        hints = {arm.video.hint for arm in self.arms.all() if arm.is_open and arm.video}
        network = _TLS_TEXT if self._uses_tls else _INSECURE_TEXT
        moved = _MOVED_TEXT if self._address.is_unusual else ""
        return [
            text for text in (moved, *missing, *hints, "" if self._is_local else network) if text
        ]


_MOVED_TEXT = f"Port {USUAL_PORT} is in use, so the page is served at the next free port."
_NO_CAMERA_TEXT = "There is no picture from {} now: the page shows it once the camera is available."
_TLS_TEXT = (
    "The network can reach this page. Browsers do not know its certificate and warn once: "
    "continue only if the fingerprint that the browser shows is the one above."
)
_INSECURE_TEXT = (
    "The network can reach this page over plain HTTP: anyone on that network can read and alter "
    "the page and the commands that move the arm. Leave out --insecure to use TLS, or use an "
    "SSH tunnel: ssh -L 8420:localhost:8420 HOST"
)


def _check_address(listen: str) -> str:
    """Check that an address is a single address; a browser cannot open a wildcard address."""
    with contextlib.suppress(ValueError):
        address = ipaddress.ip_address(listen)
        if not address.is_unspecified:
            return str(address)
    expected = "one IP address of this machine, such as 127.0.0.1"
    raise BadValueError("--listen", shown(listen), expected)
