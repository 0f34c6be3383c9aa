"""A hundred thousand damaged files of the shipped arms are each read or refused quickly."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from ikservo.errors import IkservoError
from ikservo.model.arm_file import read_arm_file
from ikservo.model.urdf import read_urdf
from ikservo.model.urdf_types import Urdf
from tests.model.test_file_mutations import SPLICES
from tests.oracle import ARMS, CONFIGS

COUNTS = [100, pytest.param(100_000, marks=(pytest.mark.campaign, pytest.mark.timeout(3600)))]


def damaged(data: bytes, chance: random.Random) -> bytes:
    for _ in range(chance.randint(1, 4)):
        at, lost = chance.randrange(len(data) + 1), chance.randint(0, 40)
        data = data[:at] + chance.choice(SPLICES) + data[at + lost :]
    return data


def read(path: Path, reader: Callable[[Path], object]) -> object | None:
    """Return the parsed file; any error but ours, or a long wait, fails the test."""
    start_s = time.perf_counter()
    try:
        return reader(path)
    except IkservoError:
        return None
    finally:
        assert time.perf_counter() - start_s < 5.0, path.read_bytes()


@pytest.mark.parametrize("count", COUNTS)
def test_damaged_urdf_is_read_or_refused_in_campaign(tmp_path: Path, count: int) -> None:
    chance = random.Random(7)
    wholes = [(CONFIGS / name / "arm.urdf").read_bytes() for name in ARMS]
    for _ in range(count):
        (tmp_path / "arm.urdf").write_bytes(damaged(chance.choice(wholes), chance))
        urdf = read(tmp_path / "arm.urdf", read_urdf)
        for joint in urdf.joints if isinstance(urdf, Urdf) else ():
            assert joint.lower <= joint.upper


@pytest.mark.parametrize("count", COUNTS)
def test_damaged_arm_file_is_read_or_refused_in_campaign(tmp_path: Path, count: int) -> None:
    chance = random.Random(8)
    wholes = [(CONFIGS / name / "arm.toml").read_bytes() for name in ARMS]
    for _ in range(count):
        (tmp_path / "arm.toml").write_bytes(damaged(chance.choice(wholes), chance))
        read(tmp_path / "arm.toml", read_arm_file)
