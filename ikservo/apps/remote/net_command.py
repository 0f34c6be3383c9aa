"""``ikservo net``: certificates for other machines, and the acknowledgement of a stop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ikservo.apps.remote.address import parse_address
from ikservo.apps.remote.certificates import keys_folder, make_keys
from ikservo.apps.remote.wire_messages import ServedHealth, parse_result
from ikservo.apps.remote.zenoh_network import connect
from ikservo.cli.options import JsonOption, PortOption
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.errors import InputError

Folder = Annotated[Path, typer.Option("--folder", help="Folder for the keys.")]
Host = Annotated[
    list[str] | None,
    typer.Option("--host", help="Name or address of the machine with the arm; repeatable."),
]
New = Annotated[bool, typer.Option("--new", help="Replace the keys; the old ones stop working.")]


def keys(
    *,
    folder: Folder = Path("ikservo-keys"),
    host: Host = None,
    new: New = False,
    json: JsonOption = False,
) -> None:
    """Make certificates that allow other machines to watch or drive an arm.

    ikservo net keys --host lab-pi --host 192.168.1.7
    """
    made = make_keys(folder, host or [], overwrite=new)
    if json:
        print_json("net-keys", folders=[str(path) for path in made], hosts=host or [])
        return
    print_lines([str(path) for path in made])
    print_status(f"Copy the folder for its role to each machine, as {keys_folder()}:")
    print_status(
        "Use server on the machine with the arm, operator on a machine that drives it, watcher on "
        "a machine that only watches it."
    )
    print_status("Keep the authority folder secret: anyone who has it can make operator keys.")


def acknowledge(*, port: PortOption = None, json: JsonOption = False) -> None:
    """Acknowledge a stop of an arm on another machine; it may move again, but nothing moves yet.

    ikservo net acknowledge --port zenoh:desk@lab-pi
    """
    if port is None:
        raise InputError("No address given.", "Add --port, as in --port zenoh:desk@lab-pi.")
    connection = connect(parse_address(port))
    try:
        before = parse_result(ServedHealth, connection.watch("health"))
        connection.drive("acknowledge")
    finally:
        connection.close()
    reason = before.stop_text
    if json:
        print_json("net-acknowledge", arm=before.arm, reason=reason)
    else:
        print_lines([f"acknowledged  {reason}" if reason else "the arm was not stopped"])
