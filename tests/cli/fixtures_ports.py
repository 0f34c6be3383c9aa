"""Serial ports that appear and disappear, faults on the simulated bus, and runs of commands."""

import io
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass

import servosim
from ikservo.cli import main
from tests.cli.conftest import CommandResult


@dataclass
class PortInfo:
    """A serial port as pyserial describes it."""

    device: str
    vid: int | None = 0x1A86
    pid: int | None = 0x55D3
    serial_number: str | None = "58FA083"
    product: str | None = "USB Single Serial"


def set_ports(monkeypatch, *lists):
    """Let each listing of the serial ports return the next list; the last one stays."""
    left = list(lists)

    def comports():
        return left.pop(0) if len(left) > 1 else left[0]

    monkeypatch.setattr("serial.tools.list_ports.comports", comports)


def change_bus(monkeypatch, change):
    """Apply `change(line)` to each simulated bus when it is opened; return the list of ports."""
    ports, opened = [], servosim.open_port

    def open_port(url):
        ports.append(opened(url))
        change(ports[-1].line)
        return ports[-1]

    monkeypatch.setattr("servosim.open_port", open_port)
    return ports


def run_command(words):
    """Run ``ikservo`` in a fixture that outlives the capture of one test."""
    return run_arguments(words.split())


def run_arguments(words):
    """Run ``ikservo`` with arguments that may hold spaces."""
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        code = main(words)
    return CommandResult(code, out.getvalue(), err.getvalue())
