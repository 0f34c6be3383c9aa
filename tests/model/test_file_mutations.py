"""Reading a damaged file succeeds or fails with one of our errors."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from ikservo.errors import IkservoError
from ikservo.model.arm_file import read_arm_file
from ikservo.model.urdf import read_urdf

SETTINGS = settings(
    max_examples=500,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
SPLICES = [b"nan", b"1e999", b"-1", b"0", b"true", b'"', b"<", b"/>", b"&x;", b"<!DOCTYPE a>"]
SPLICES += [
    b"[",
    b"]]",
    b"{",
    b"= ",
    b"\n",
    b"\0",
    b"\xff",
    b"..",
    b"[[joints]]\n",
    b"]]>",
    b"<!--",
]

damages = st.lists(
    st.tuples(
        st.integers(0, 10_000),  # where, counted around the end
        st.integers(0, 40),  # how many bytes are lost
        st.one_of(st.sampled_from(SPLICES), st.binary(max_size=4)),  # what comes in their place
    ),
    min_size=1,
    max_size=4,
)


@pytest.fixture(scope="module")
def a_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("damaged") / "arm.urdf"


def damaged(text: str, wounds: list[tuple[int, int, bytes]]) -> bytes:
    data = text.encode()
    for place, lost, spliced in wounds:
        at = place % len(data) if data else 0
        data = data[:at] + spliced + data[at + lost :]
    return data


def read_or_refuse(read: Callable[[Path], object], path: Path, data: bytes) -> None:
    path.write_bytes(data)
    with suppress(IkservoError):
        read(path)


@pytest.mark.full
@seed(101)
@SETTINGS
@given(wounds=damages)
def test_damaged_urdf_raises_only_ikservo_errors(
    a_path: Path, urdf_text: str, wounds: list[tuple[int, int, bytes]]
) -> None:
    read_or_refuse(read_urdf, a_path, damaged(urdf_text, wounds))


@pytest.mark.full
@seed(101)
@SETTINGS
@given(wounds=damages)
def test_damaged_arm_file_raises_only_ikservo_errors(
    a_path: Path, arm_text: str, wounds: list[tuple[int, int, bytes]]
) -> None:
    arm_path = a_path.with_name("arm.toml")
    read_or_refuse(read_arm_file, arm_path, damaged(arm_text, wounds))
