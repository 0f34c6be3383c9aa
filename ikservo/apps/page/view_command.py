"""``ikservo view``: serve the browser panel, in which the arm is dragged with the mouse."""

from __future__ import annotations

import io
import ipaddress
import os
import sys
import tempfile
import webbrowser
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ikservo.apps.cameras.camera_command import CameraNameOption, check_camera_name
from ikservo.cli.completion import complete_arms
from ikservo.cli.model_options import model_from_option
from ikservo.cli.open_and_confirm import warn_uncompiled
from ikservo.cli.option_groups import Without
from ikservo.cli.options import MotionOptions, SceneOption, ServoConnection
from ikservo.cli.terminal import print_lines, print_status
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import InputError
from ikservo.files.writing import check_writable
from ikservo.hardware.port_choice import choose_port, simulated_port_url
from ikservo.model import Model
from ikservo.model.scene_file import read_scene_with_arms, with_scene_and_arms
from ikservo.remedies import install_command

if TYPE_CHECKING:
    from ikservo.apps.page.page_app import ViewApp, ViewUrls
    from ikservo.apps.page.panels.episode_panel import EpisodeFolder
    from ikservo.apps.page.served_arms import ArmAtPort

_NEEDS = ("starlette", "uvicorn", "websockets")
_TLS_NEEDS = ("cryptography", "segno")
_LISTEN_HELP = "IP address of the panel; any but a loopback address serves the network, over TLS."

Arms = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[ARM[=PORT]]…",
        help="Arms to open, each with its port; for a single arm, --arm and --port work as well.",
        autocompletion=complete_arms,
    ),
]
HttpPort = Annotated[
    int | None,
    typer.Option(
        "--http-port",
        min=0,
        max=65535,
        help="TCP port of the panel; 0: any; default: 8420, or the next free one.",
    ),
]
Insecure = Annotated[
    bool,
    typer.Option(
        "--insecure",
        help="Serve the page to the network without TLS; others can read and change the traffic.",
    ),
]
Cameras = Annotated[
    list[str] | None,
    typer.Option(
        "--camera",
        metavar="SOURCE",
        help="Camera whose picture is shown beside the arm: a number, /dev/video0, http://…, a "
        "file or sim; repeatable. Each arm shows the camera that it was calibrated with.",
    ),
]
Listen = Annotated[str, typer.Option("--listen", metavar="ADDRESS", help=_LISTEN_HELP)]
Servos = Annotated[
    bool,
    typer.Option("--servos", help="Show registers, ids and backups of servos instead of an arm."),
]
Record = Annotated[
    Path | None,
    typer.Option(
        "--record",
        metavar="FOLDER",
        help="LeRobot data set, new or existing, to which the page adds episodes of the arm and "
        "its cameras.",
    ),
]
TaskText = Annotated[
    str, typer.Option("--task", metavar="TEXT", help="Description of the task, for --record.")
]
NoOpen = Annotated[bool, typer.Option("--no-open", help="Do not open a browser.")]


def command(
    arms: Arms = None,
    *,
    connection: ServoConnection,
    http_port: HttpPort = None,
    listen: Listen = "127.0.0.1",
    insecure: Insecure = False,
    no_open: NoOpen = False,
    camera: Cameras = None,
    camera_name: CameraNameOption = "",
    scene: SceneOption = None,
    servos: Servos = False,
    record: Record = None,
    task: TaskText = "",
    options: Annotated[MotionOptions, Without("dry_run", "no_wiggle", "tip", "yes", "json")],
) -> None:
    """Serve the browser panel; an arm moves only after Go there, Play, Relax or Live.

    Without an arm, the panel lists arms and ports.

    ikservo view --port sim                      no arm needed

    ikservo view so101=/dev/ttyACM0 koch=/dev/ttyUSB0

    ikservo view --servos --port /dev/ttyACM0    the servos of any arm, or without an arm

    ikservo view --port sim --listen 192.168.0.7     for other machines, over TLS

    ikservo view so101 --camera 0 --record my_set --task "stack the cubes"
    """
    _check_installed(_NEEDS if insecure or _is_loopback(listen) else (*_NEEDS, *_TLS_NEEDS))
    check_camera_name(camera_name)
    if camera or camera_name:
        _check_installed(["cv2"], "camera")
    from ikservo.apps.page.page_app import ViewApp  # noqa: PLC0415  # --help does not need it

    bench = _bench_from_options(arms, connection, camera or camera_name) if servos else None
    places = [] if bench else _places_from_options(arms or [], connection.arm, connection.port)
    if scene is not None:
        places = _among_things(places, scene)
    app = ViewApp(places, listen, http_port, insecure=insecure, collisions=options.collision,
                  uncalibrated=options.uncalibrated, cameras=camera or (), camera_name=camera_name,
                  servos=bench, offered_port=connection.port,
                  record=_episode_folder(record, task, places))  # fmt: skip
    with exiting_on_signals(), app as urls:  # moving arms brake, and writes are finished
        print_status("To control the arm:")
        sys.stderr.flush()  # prints the label before the URL
        print_lines([urls.control])
        sys.stdout.flush()
        print_status(f"To watch only:\n{urls.watch}")
        if urls.fingerprint:
            _print_certificate(urls)
        for warning in urls.warnings:
            print_status(warning)
        if record is not None and not camera:
            print_status("No --camera is given, so episodes have no pictures.")
        if bench is None:
            _print_arms(app, has_camera=bool(camera or camera_name))
            warn_uncompiled()
        print_status("Ctrl-C ends the panel; torque does not change.")
        sys.stdout.flush()
        has_display = sys.platform != "linux" or bool(
            os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        )
        with _open_browser(urls.control, enabled=has_display and not no_open):
            app.serve()
    print_status("Torque stays as it was. Switch it off with: ikservo relax")


def _episode_folder(
    record: Path | None, task: str, places: Sequence[ArmAtPort]
) -> EpisodeFolder | None:
    """Return the data set to which the page records; None without ``--record``.

    Raises:
        InputError: The task is missing, or there is not exactly one arm.
        FileWriteError: The folder is not writable.
    """
    from ikservo.apps.page.panels.episode_panel import EpisodeFolder  # noqa: PLC0415  # as above

    if record is None:
        if task:
            raise InputError("--task describes episodes.", "Add --record FOLDER.")
        return None
    if not task:
        raise InputError(
            "The episodes have no task.", 'Say what is shown, as in --task "stack the cubes".'
        )
    if record.is_file():
        raise InputError(f"{record} is a file.", "Give a folder.")
    if len(places) != 1:
        raise InputError(
            f"--record needs exactly one arm, not {len(places)}.",
            "Name it, as in: ikservo view so101 --record my_set",
        )
    check_writable(record)
    return EpisodeFolder(record, task)


def _bench_from_options(
    arms: Sequence[str] | None, connection: ServoConnection, camera: Sequence[str] | None
) -> tuple[str, Model | None]:
    """Return the port of the servos, by default the only one, and their arm if it is given.

    Raises:
        NoPortError: There is no port, or more than one to choose from.
        InputError: An option for arms is given.
    """
    if arms or camera:
        raise InputError(
            "--servos does not open arms or cameras.",
            "Leave them out; --arm names the servos' arm.",
        )
    model = model_from_option(connection.arm) if connection.arm else None
    port = choose_port(connection.port, model.name if model else "")
    simulated_port_url(port, model.path if model else None)  # a simulated bus needs its arm
    return port, model


def _places_from_options(arms: Sequence[str], arm: str | None, port: str | None) -> list[ArmAtPort]:
    """Return the arms to open, with their ports."""
    from ikservo.apps.page.served_arms import ArmAtPort  # noqa: PLC0415  # --help does not need it

    simulated = (port or "").partition(":")[0] == "sim"
    if not arms and not arm and not simulated:
        return []  # a port is offered on the page
    if arms and arm and arm != os.environ.get("IKSERVO_ARM"):
        raise InputError(
            f"Both --arm {arm} and {' '.join(arms)} are given.", "Name all arms without --arm."
        )
    named = arms or [arm or ("so101" if simulated else "")]
    pairs = [(name, own) for name, _, own in (each.partition("=") for each in named)]
    if port and not simulated and sum(not own for _, own in pairs) > 1:
        raise InputError(
            f"--port {port} gives one port for {len(pairs)} arms.",
            "Give each its own: ikservo view so101=/dev/ttyACM0 koch=/dev/ttyUSB0",
        )
    return [ArmAtPort(model_from_option(name), own or port) for name, own in pairs]


def _among_things(places: list[ArmAtPort], scene: Path) -> list[ArmAtPort]:
    """Put the things of a scene file around the only opened arm that the file does not name.

    Other arms are opened at the ports of the file, unless ports are given.

    Raises:
        InputError: There is not exactly one such arm, whose base frame the file uses; or the file
            has an arm that is not opened.
        FileFormatError: The file is malformed.
    """
    from ikservo.apps.page.served_arms import page_names  # noqa: PLC0415  # as above

    names = page_names(place.model.name for place in places)
    _, arms = read_scene_with_arms(scene)
    for each in arms:
        if each.name not in names:
            raise InputError(
                f"{scene} also has the arm {each.name}, which is not being opened.",
                f"Open that arm as well, as in: ikservo view "
                f"{' '.join([*names, each.arm or each.name])}",
            )
    around = [name for name in names if name not in {each.name for each in arms}]
    if len(around) != 1:
        named = " that it does not name" if arms else ""
        raise InputError(
            f"--scene {scene} needs exactly one arm{named}, not {len(around)}.",
            "The file uses the base frame of one arm: open only that arm with it and the others "
            "on the page, or add the others to the file as [[arm]].",
        )
    first = names.index(around[0])
    model, other_arms = with_scene_and_arms(places[first].model, scene)
    ports = {each.name: each.port or None for each in other_arms}
    pairs = zip(names, places, strict=True)
    placed = [replace(each, port=each.port or ports.get(name)) for name, each in pairs]
    placed[first] = replace(placed[first], model=model, other_arms=other_arms)
    return placed


def _print_arms(app: ViewApp, *, has_camera: bool) -> None:
    """Print which arms could not be opened, or that none is open yet."""
    served = app.arms.all()
    if not served:
        shown = " The page then shows the camera's picture." if has_camera else ""
        print_status(f"No arm is open. Choose one on the page; this does not move it.{shown}")
    for each in served:
        if each.error is not None:
            print_status(f"{each.name}: {each.error.message}\n{each.error.hint}")


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return True  # an invalid address is refused later


def _check_installed(needs: Sequence[str], extra: str = "view") -> None:
    missing = [name for name in needs if find_spec(name) is None]
    if missing:
        raise InputError(
            f"The panel needs {', '.join(missing)}, which is not installed.",
            f"Install it: {install_command(extra)}",
        )


def _print_certificate(urls: ViewUrls) -> None:
    """Print the fingerprint of the page, and QR codes of its addresses for a phone."""
    import segno  # noqa: PLC0415  # needed only for other machines

    print_status(f"SHA-256 fingerprint of its certificate:\n{urls.fingerprint}")
    for label, url in (("to watch only", urls.watch), ("to control the arm", urls.control)):
        picture = io.StringIO()
        segno.make(url, error="l", micro=False).terminal(picture, compact=True)
        print_status(f"QR code {label}:")
        sys.stderr.write(picture.getvalue())


@contextmanager
def _open_browser(url: str, *, enabled: bool) -> Generator[None]:
    """Open a browser through a private file, because other users can read command lines."""
    if not enabled:
        yield
        return
    with tempfile.TemporaryDirectory(prefix="ikservo-") as folder:
        page = Path(folder) / "view.html"
        page.touch(mode=0o600)
        page.write_text(f'<meta http-equiv="refresh" content="0; url={url}">', encoding="utf-8")
        webbrowser.open(page.as_uri())
        yield
