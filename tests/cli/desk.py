"""What may lie on a person's desk: adapters that come and go, and a simulated line to spoil."""

import io
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass

import servosim
from ikservo.cli import main
from tests.cli.conftest import Said


@dataclass
class Comport:
    """What pyserial tells of a port."""

    device: str
    vid: int | None = 0x1A86
    pid: int | None = 0x55D3
    serial_number: str | None = "58FA083"
    product: str | None = "USB Single Serial"


def plug_in(monkeypatch, *looks):
    """Let each look at the adapters find the next list; the last stays."""
    left = list(looks)

    def comports():
        return left.pop(0) if len(left) > 1 else left[0]

    monkeypatch.setattr("serial.tools.list_ports.comports", comports)


def spoil(monkeypatch, change):
    """Let something happen to the simulated line as soon as it is opened; return the ports."""
    ports, opened = [], servosim.open_port

    def open_port(url):
        ports.append(opened(url))
        change(ports[-1].line)
        return ports[-1]

    monkeypatch.setattr("servosim.open_port", open_port)
    return ports


def run(words):
    """Run ``ikservo`` where a fixture outlives the test that captures its output."""
    return run_words(words.split())


def run_words(words):
    """Run ``ikservo`` with words that may hold spaces."""
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        code = main(words)
    return Said(code, out.getvalue(), err.getvalue())
