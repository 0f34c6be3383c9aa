"""The arms of one page; each has its own thread and controller and can fail on its own."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from enum import StrEnum

from ikservo.apps.page.dragging.snapshot import StopNotice
from ikservo.apps.page.message_handling import SessionController
from ikservo.apps.page.messages.page_messages import BadMessageError, Message
from ikservo.apps.page.page_updates import mode
from ikservo.apps.page.panels.episode_panel import EpisodeFolder, EpisodePanel
from ikservo.apps.page.panels.follow_panel import FindArm
from ikservo.apps.page.panels.page_cameras import ArmCameras, PageCameras
from ikservo.apps.page.panels.video import VideoSource
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.running.calibration_panel import CalibrationDriver
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.page.server.downloads import DownloadOffers
from ikservo.apps.page.server.server import Frame, SessionEndedError
from ikservo.arm import DEAD_MAN_TIMEOUT_S, Arm
from ikservo.arm.scene import Scene
from ikservo.clock import Clock
from ikservo.errors import IkservoError, InputError
from ikservo.hardware.port_names import is_simulated, real_time_port
from ikservo.model import Model
from ikservo.model.scene_file import PlacedArm
from ikservo.planning.reports import describe_torque

_MAX_ARMS = 8
# Initial place of another arm that the page adds, until the user types its place.
_OPPOSITE_M, _FACING_DEG = (0.5, 0.0, 0.0), (0.0, 0.0, 180.0)
_FAILED_HINT = "See the terminal, then open the arm again."


class ServedArmState(StrEnum):
    """State of an arm on the page."""

    OPENING = "opening"
    OPEN = "open"
    FAILED = "failed"
    CLOSING = "closing"


@dataclass(frozen=True, slots=True)
class ArmAtPort:
    """An arm to open, and its port.

    Attributes:
        model: The arm.
        port: The port; None: the remembered or the only port.
        other_arms: The bases of other arms that are opened with it, by their names on the page.
    """

    model: Model
    port: str | None = None
    other_arms: tuple[PlacedArm, ...] = ()


@dataclass(frozen=True, slots=True)
class ViewSettings:
    """Common settings of all arms of a page.

    Attributes:
        open_arm: Opens an arm at a port.
        clock: The time of heartbeats.
        downloads: Stores the files that pages request.
        dead_man_s: The time for which an arm follows without a heartbeat of its page.
        cameras: The cameras of the page; None for no camera.
        record: The data set to which episodes of the arm are recorded; None for no recording.
    """

    open_arm: Callable[[Model, str | None], Arm]
    clock: Clock
    downloads: DownloadOffers
    dead_man_s: float = DEAD_MAN_TIMEOUT_S
    cameras: PageCameras | None = None
    record: EpisodeFolder | None = None


def page_names(models: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """Return the names of arms on a page: model names, numbered from a model's second arm on."""
    names, known = list[str](), set(taken)
    for stem in models:
        numbered = (f"{stem}-{i}" for i in itertools.count(2))
        names.append(next(n for n in itertools.chain([stem], numbered) if n not in known))
        known.add(names[-1])
    return names


class ServedArm:
    """One arm of the page, and the backend of the pages that show it (``SessionBackend``).

    Args:
        name: The name, unique among the arms of the page.
        place: The arm and its port.
        settings: The settings that all arms share.
        find_arm: Finds another arm of the page, to be followed.
        before: The things around the arm when it was last closed, if it was open before.

    Attributes:
        state: State of the arm; written by the thread that opens it, then by the server's thread.
        error: The reason why the arm could not be opened.
        arm_thread: Owns the arm; exists while it is open.
        controller: Handles the clients; exists while the arm is open.
        cameras: The cameras that the arm may show; None if it has none.
        camera_error: The reason why an expected camera is missing.
    """

    arm_thread: ArmThread
    controller: SessionController

    def __init__(
        self,
        name: str,
        place: ArmAtPort,
        settings: ViewSettings,
        find_arm: FindArm,
        before: Scene | None = None,
    ) -> None:
        self.name, self.place, self._settings = name, place, settings
        self._find_arm, self._before = find_arm, before
        self.has_been_open = False
        self.state = ServedArmState.OPENING
        self.error: StopNotice | None = None
        self.cameras: ArmCameras | None = None
        self.camera_error: IkservoError | None = None
        self._exits = ExitStack()

    def open(self) -> None:
        """Open the arm; nothing moves and no torque changes.

        Raises:
            IkservoError: The arm cannot be opened; ``error`` also gives the reason.
        """
        try:
            self._exits = self._start()
        except Exception as error:
            ours = isinstance(error, IkservoError)
            text = error.message if ours else f"The panel failed: {error!r}."
            self.error = StopNotice(text, error.command_hint if ours else _FAILED_HINT)
            self.state = ServedArmState.FAILED
            raise
        self.state = ServedArmState.OPEN

    def _start(self) -> ExitStack:
        model, settings = self.place.model, self._settings
        port = real_time_port(self.place.port)
        with ExitStack() as stack:
            self.arm_thread = stack.enter_context(
                ArmThread(
                    self._open_arm,
                    settings.clock,
                    settings.dead_man_s,
                    CalibrationDriver(model, port),
                )
            )
            scene, before = self.arm_thread.arm.scene, self._before
            if before is not None and before.arms and before.is_of_same_arm(scene):
                scene.take_over(before)
            self.has_been_open = True
            try:
                cameras = settings.cameras
                self.cameras = cameras and ArmCameras(cameras, self.arm_thread.arm, stack)
                if self.cameras and self.cameras.video and self.arm_thread.calibration:
                    self.arm_thread.calibration.open_camera = self.cameras.calibrating
            except IkservoError as error:
                self.camera_error = error
            record, episodes = settings.record, None
            if record is not None:
                episodes = EpisodePanel(
                    self.arm_thread, settings.clock, record, self.cameras, stack
                )
            self.controller = SessionController(
                self.arm_thread,
                settings.clock,
                settings.downloads,
                self._find_arm,
                self.cameras,
                self.add_other_arm,
                episodes,
            )
            stack.callback(self.controller.close)
            return stack.pop_all()

    def _open_arm(self) -> Arm:
        arm = self._settings.open_arm(self.place.model, real_time_port(self.place.port))
        if self.cameras is not None:
            self.cameras.follow(arm)
        return arm

    def add_other_arm(
        self,
        name: str,
        at_m: tuple[float, float, float] = _OPPOSITE_M,
        rpy_deg: tuple[float, float, float] = _FACING_DEG,
    ) -> None:
        """Make this arm and another arm of the page obstacles to each other.

        ``at_m`` (3,) and ``rpy_deg`` (3,) place the other arm in the base frame of this arm.

        Raises:
            InputError: No other arm of that name is open, or it is moving.
            RefusedError: The position of the other arm cannot be measured.
        """
        other = self._find_arm(name)
        if other is None or other is self.arm_thread:
            raise InputError(f"No other arm {name!r} is open.", "Open it from the list of arms.")
        if other.job is not None or other.command.live or other.snapshot.calibration:
            raise InputError(
                f"{name} is moving.", "Switch Live off for that arm, and wait until it is at rest."
            )
        self.arm_thread.arm.scene.add_arm(other.arm, name, at_m, rpy_deg, own_name=self.name)

    def close(self) -> None:
        """Let the arm hold and close its port; wait for both."""
        self._exits.close()

    @property
    def is_open(self) -> bool:
        """Whether pages can show the arm."""
        return self.state is ServedArmState.OPEN

    def fields(self) -> dict[str, object]:
        """Return the fields for the list of arms."""
        what = StopNotice("", "") if self.error is None else self.error
        state = self.state.value
        if self.is_open:
            snapshot = self.arm_thread.snapshot
            state = mode(snapshot, live=self.arm_thread.command.live)
            what = snapshot.stop_notice or StopNotice(describe_torque(snapshot.states), "")
        return {
            "name": self.name,
            "title": self.place.model.title,
            "port": self.port_name,
            "state": state,
            "text": what.message,
            "hint": what.hint,
            "camera": self._camera_fields(),
        }

    @property
    def video(self) -> VideoSource | None:
        """The pictures of the arm's camera, if it has one."""
        return self.cameras and self.cameras.video

    def _camera_fields(self) -> dict[str, object] | None:
        """Return the camera, its problem, and the choices; None without a camera."""
        if self.camera_error is not None:
            return {"name": "no camera", "trouble": self.camera_error.message}
        if self.cameras is None or self.video is None:
            return None
        return {
            "name": self.video.name,
            "trouble": self.video.trouble,
            "late": self.video.is_late,
            "calibrated": self.is_open and self.controller.is_camera_calibrated,
            "choices": list(self.cameras.choices),
            "chosen": self.cameras.chosen,
        }

    @property
    def port_name(self) -> str:
        """The port's name without the options of a simulated port."""
        name = self.arm_thread.arm.port_name if self.is_open else self.place.port
        return (name or "").partition("?")[0].partition(":/")[0].rstrip(":")

    # --- SessionBackend ---

    def connect(self, permission: Permission) -> int:
        """Register a client and return its number."""
        return self.controller.connect(permission)

    def disconnect(self, client_id: int) -> None:
        """Remove a client."""
        self.controller.disconnect(client_id)

    def receive(self, client_id: int, message: Message) -> None:
        """Handle a client's message.

        Raises:
            IkservoError: The request is not permitted, or impossible now; the client gets the text.
            SessionEndedError: The arm was closed.
        """
        self._require_open()
        self.controller.receive(client_id, message)

    def frames(self, client_id: int) -> list[Frame]:
        """Return the new frames for a client; the first names the arm.

        Raises:
            SessionEndedError: The arm was closed.
        """
        self._require_open()
        return [
            {**frame, "arm": self.name} if frame["kind"] == "arm_info" else frame
            for frame in self.controller.frames(client_id)
        ]

    def _require_open(self) -> None:
        if not self.is_open:
            raise SessionEndedError("This arm was closed.")


class ServedArms:
    """Opens, stops and closes the arms of one page; only the server's thread may call it."""

    def __init__(self, settings: ViewSettings) -> None:
        self._settings = settings
        self._arms: dict[str, ServedArm] = {}
        self._closed: dict[str, Scene] = {}

    @property
    def camera_names(self) -> list[str]:
        """Names of the cameras that arms will show once they are open."""
        return self._settings.cameras.names if self._settings.cameras else []

    def all(self) -> list[ServedArm]:
        """Return all arms in order of opening, including arms that could not be opened."""
        return list(self._arms.values())

    def find(self, name: str) -> ServedArm | None:
        """Find an open arm by its name, or the first open arm if no name is given; None if none."""
        found = [arm for arm in self.all() if arm.is_open and name in ("", arm.name)]
        return found[0] if found else None

    def _find_thread(self, name: str) -> ArmThread | None:
        found = self.find(name)
        return None if found is None else found.arm_thread

    def open_all(self, places: Sequence[ArmAtPort]) -> None:
        """Open arms and wait for them; arms that cannot be opened stay in the list.

        Raises:
            IkservoError: The first error, if no arm could be opened, or an arm with a given place
                could not be opened or made an obstacle.
        """
        failed: list[IkservoError] = []
        added = [self._add(place) for place in places]
        for arm in added:
            try:
                arm.open()
            except IkservoError as error:
                failed.append(error)
        if failed and (len(failed) == len(places) or any(place.other_arms for place in places)):
            raise failed[0]
        self._settings = replace(self._settings, record=None)  # arms that the page opens have none
        for arm in added:
            for each in arm.place.other_arms:
                arm.add_other_arm(each.name, each.at_m, each.rpy_deg)

    def check_free(self, place: ArmAtPort) -> None:
        """Check that no open arm uses a port, and forget failed attempts to open an arm there.

        Raises:
            BadMessageError: The port is already in use here.
        """
        for other in self.all():
            if other.place.port != place.port:
                continue
            if other.state is ServedArmState.FAILED:
                del self._arms[other.name]
            elif place.port is not None and not is_simulated(place.port):
                raise BadMessageError(f"{other.name} is open on {place.port}.", "Close it first.")

    def start_opening(self, place: ArmAtPort) -> None:
        """Open an arm in a separate thread; ``all`` shows its state.

        Raises:
            BadMessageError: The port is already in use here, or there are too many arms.
        """
        self.check_free(place)
        if len(self._arms) >= _MAX_ARMS:
            raise BadMessageError(f"{_MAX_ARMS} arms are open.", "Close one of them first.")
        arm = self._add(place)
        threading.Thread(target=arm.open, name=f"ikservo open {arm.name}", daemon=True).start()

    def _add(self, place: ArmAtPort) -> ServedArm:
        name = page_names([place.model.name], self._arms)[-1]
        before = self._closed.get(name)
        arm = ServedArm(name, place, self._settings, self._find_thread, before)
        self._arms[arm.name] = arm
        return arm

    def stop(self, name: str | None, by: str) -> None:
        """Stop one arm, or every open arm if no name is given; it holds until acknowledged.

        Args:
            name: The arm; None: every open arm.
            by: The actor, as the beginning of a sentence.
        """
        for arm in self.all():
            if arm.is_open and name in (None, arm.name):
                arm.controller.stop(by)

    def start_closing(self, name: str) -> None:
        """Close an arm in a separate thread; torque stays unchanged.

        Raises:
            BadMessageError: There is no such arm, or it is still being opened.
        """
        arm = self._arms.get(name)
        if arm is None or arm.state is ServedArmState.CLOSING:
            raise BadMessageError(f"No arm {name!r} is open.")
        if arm.state is ServedArmState.OPENING:
            raise BadMessageError(
                f"{name} is still being opened.", "Wait until it is open, then close it."
            )
        arm.state = ServedArmState.CLOSING
        threading.Thread(target=self._close, args=(arm,), name=f"ikservo close {name}").start()

    def _close(self, arm: ServedArm) -> None:
        try:
            arm.close()
        finally:
            if arm.has_been_open:
                self._closed[arm.name] = arm.arm_thread.arm.scene
            self._arms.pop(arm.name, None)

    def close(self) -> None:
        """Let every arm hold and close all ports."""
        for arm in self.all():
            arm.close()
