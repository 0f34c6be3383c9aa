"""``ikservo ports``: list the connected adapters, and identify them."""

from __future__ import annotations

from itertools import islice
from typing import Annotated

import typer

from ikservo.cli.options import JsonOption
from ikservo.cli.results import Field, Fields, json_values, print_records
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.hardware.serial_ports import SerialAdapter, list_adapters, watch_adapters

Watch = Annotated[
    bool, typer.Option("--watch", help="Report adapters as they are plugged in or unplugged.")
]
Events = Annotated[
    int | None, typer.Option("--events", min=1, help="Stop after this many changes.")
]


def command(*, watch: Watch = False, events: Events = None, json: JsonOption = False) -> None:
    """List the USB serial adapters with chip, stable name and the program that uses each.

    ikservo ports

    ikservo ports --watch        unplug one to see its name
    """
    found = list_adapters()
    if not watch:
        if found or json:
            print_records("ports", "ports", found, _FIELDS, json=json, order=_COLUMNS)
        else:
            print_status("No USB serial adapter found. Without an arm: --port sim")
        return
    print_status(f"Plugged in now: {', '.join(adapter.device for adapter in found) or 'none'}.")
    print_status("Plug in or unplug an adapter; Ctrl-C ends.")
    for change in islice(watch_adapters(), events):
        adapter = change.adapter
        if json:
            print_json("ports-event", event=change.event, port=json_values(adapter, _FIELDS))
        else:
            named = f"  {adapter.by_id}" if adapter.by_id else ""
            print_lines([f"{change.event:9}  {adapter.device}  {adapter.chip}{named}"])


_FIELDS: Fields[SerialAdapter] = (
    Field("device", "port"),
    Field("by_id", "by id"),
    Field("chip", "chip"),
    Field("usb", "usb"),
    Field("serial_number", "serial number", lambda adapter: adapter.serial_number or "-"),
    Field("holder", "used by", lambda adapter: adapter.used_by or "-", lambda a: a.used_by),
)
_COLUMNS = "device chip usb serial_number holder by_id"
