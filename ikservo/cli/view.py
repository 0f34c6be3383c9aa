"""``ikservo view``: serve a page on which the arm is dragged with the mouse."""

from __future__ import annotations

import os
import sys
import tempfile
import webbrowser
from collections.abc import Generator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import ArmOption, CollisionOption, PortOption, UncalibratedOption
from ikservo.cli.session import warn_uncompiled
from ikservo.cli.terminal import print_lines, print_status
from ikservo.errors import InputError

__all__ = ["command"]

_NEEDS = ("starlette", "uvicorn", "websockets")
_LISTEN_HELP = (
    "IP address of the page; any but a loopback address makes it reachable from the network."
)

HttpPort = Annotated[
    int, typer.Option("--http-port", min=0, max=65535, help="Port of the page; 0: any.")
]
Listen = Annotated[str, typer.Option("--listen", metavar="ADDRESS", help=_LISTEN_HELP)]
NoOpen = Annotated[bool, typer.Option("--no-open", help="Do not open a browser.")]


def command(
    arm: ArmOption = None,
    *,
    port: PortOption = None,
    http_port: HttpPort = 8420,
    listen: Listen = "127.0.0.1",
    no_open: NoOpen = False,
    collision: CollisionOption = True,
    uncalibrated: UncalibratedOption = False,
) -> None:
    """Serve a page that shows the arm; it moves only after Live is switched on there.

    ikservo view --port sim                      no arm needed

    ikservo view --arm so101 --port /dev/ttyACM0
    """
    _check_installed()
    from ikservo.view.app import ViewApp  # noqa: PLC0415  # what --help does not need

    simulated = (port or "").partition(":")[0] == "sim"
    model = model_from_option(arm or ("so101" if simulated else None))
    app = ViewApp(model, port, listen, http_port, collisions=collision, uncalibrated=uncalibrated)
    with app as urls:
        print_lines([urls.control])
        print_status(f"To watch only: {urls.watch}")
        for warning in urls.warnings:
            print_status(warning)
        warn_uncompiled()
        print_status("Ctrl-C ends; torque then stays on.")
        sys.stdout.flush()
        with _open_browser(urls.control, enabled=not no_open and _has_display()):
            app.serve()
    print_status("Torque stays as it was. Switch it off with: ikservo relax")


def _check_installed() -> None:
    missing = [name for name in _NEEDS if find_spec(name) is None]
    if missing:
        raise InputError(
            f"The view needs {', '.join(missing)}; not installed.",
            "Try: pip install 'ikservo[view]'",
        )


@contextmanager
def _open_browser(url: str, *, enabled: bool) -> Generator[None]:
    """Open a browser through a file readable by its owner only: command lines are public."""
    if not enabled:
        yield
        return
    with tempfile.TemporaryDirectory(prefix="ikservo-") as folder:
        page = Path(folder) / "view.html"
        page.touch(mode=0o600)
        page.write_text(f'<meta http-equiv="refresh" content="0; url={url}">', encoding="utf-8")
        webbrowser.open(page.as_uri())
        yield


def _has_display() -> bool:
    if sys.platform != "linux":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
