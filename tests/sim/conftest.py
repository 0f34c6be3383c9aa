from __future__ import annotations

from pathlib import Path

import pytest

from servosim.assembly import BenchServo, make_bench_world
from servosim.line import Line, LineOptions
from servosim.port import SimulatedPort

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.fixture
def make_port():
    """Return loose servos on a port at 1 Mbit/s: make_port("XL430-W250", "XL330-M288")."""

    def lay_out(*models: str, ids: tuple[int, ...] = (), **options: object) -> SimulatedPort:
        ids = ids or tuple(range(1, len(models) + 1))
        servos = [BenchServo(id_, model) for id_, model in zip(ids, models, strict=True)]
        world = make_bench_world(servos, baud=1_000_000)
        port = SimulatedPort(Line(world, 1_000_000, LineOptions(**options)))
        port.timeout = 0.02
        return port

    return lay_out


@pytest.fixture
def configs() -> Path:
    """Return the folder of the arms."""
    return CONFIGS
