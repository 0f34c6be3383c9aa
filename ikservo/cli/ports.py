"""``ikservo ports``: list the connected adapters, and identify them."""

from __future__ import annotations

from itertools import islice
from typing import Annotated

import typer

from ikservo.cli.options import JsonOption
from ikservo.cli.terminal import print_json, print_lines, print_status, print_table
from ikservo.hardware.serial_ports import AdapterEvent, SerialAdapter, list_adapters, watch_adapters

__all__ = ["command"]

Watch = Annotated[
    bool, typer.Option("--watch", help="Report adapters as they are plugged in or unplugged.")
]
Events = Annotated[
    int | None, typer.Option("--events", min=1, help="Stop after this many changes.")
]


def command(*, watch: Watch = False, events: Events = None, json: JsonOption = False) -> None:
    """List the USB serial adapters: chip, stable name, the program that uses them.

    ikservo ports

    ikservo ports --watch        unplug one to see its name
    """
    found = list_adapters()
    if not watch:
        _print_adapters(found, json=json)
        return
    print_status(f"Here now: {', '.join(adapter.device for adapter in found) or 'none'}.")
    print_status("Plug in or unplug an adapter; Ctrl-C ends.")
    for change in islice(watch_adapters(), events):
        _print_event(change, json=json)


def _print_adapters(found: list[SerialAdapter], *, json: bool) -> None:
    if json:
        print_json("ports", ports=[_adapter_fields(adapter) for adapter in found])
    elif found:
        columns = ["port", "chip", "usb", "serial number", "used by", "by id"]
        print_table(columns, [_format_adapter_row(adapter) for adapter in found])
    else:
        print_status("No USB serial adapter found. Without an arm: --port sim")


def _print_event(change: AdapterEvent, *, json: bool) -> None:
    adapter = change.adapter
    if json:
        print_json("ports-event", event=change.event, port=_adapter_fields(adapter))
    else:
        named = f"  {adapter.by_id}" if adapter.by_id else ""
        print_lines([f"{change.event:9}  {adapter.device}  {adapter.chip}{named}"])


def _format_adapter_row(adapter: SerialAdapter) -> list[str]:
    return [
        adapter.device,
        adapter.chip,
        adapter.usb,
        adapter.serial_number or "-",
        adapter.used_by or "-",
        adapter.by_id,
    ]


def _adapter_fields(adapter: SerialAdapter) -> dict[str, object]:
    return {
        "device": adapter.device,
        "by_id": adapter.by_id,
        "chip": adapter.chip,
        "usb": adapter.usb,
        "serial_number": adapter.serial_number,
        "holder": adapter.used_by,
    }
