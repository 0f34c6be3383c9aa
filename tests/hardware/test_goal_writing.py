"""Every goal is checked once before its bytes are sent."""

import ast
from pathlib import Path

import pytest

import ikservo
from ikservo.errors import RefusedError
from ikservo.hardware.goal_writing import write_goals
from ikservo.registers import RegisterName
from tests.arm.simulated import servo_group

WRITES = ("write", "sync_write", "reg_write")


@pytest.fixture
def bus():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.enable()
        yield servo_group(arm)._bus


@pytest.mark.parametrize("confirmed", [False, True])
@pytest.mark.parametrize(
    ("tick", "ranges", "reached"),
    [
        (2101, {1: (2000, 2100)}, ()),
        (1999, {1: (2000, 2100)}, ()),
        (2151, {1: (2000, 2100)}, (2150,)),
        (float("nan"), {1: (2000, 2100)}, ()),
        (2050, {2: (2000, 2100)}, (2050,)),
    ],
    ids=["above", "below", "beyond where it was", "no number", "no range"],
)
def test_goal_outside_range_is_refused_with_all_others(bus, tick, ranges, reached, confirmed):
    before = [bus.read(i, RegisterName.GOAL_POSITION, raw=True) for i in (1, 3)]
    with pytest.raises(RefusedError, match="Nothing was sent"):
        write_goals(
            bus, {3: before[1] + 1, 1: tick}, {**ranges, 3: (0, 4095)},
            reached=lambda _: reached, confirmed=confirmed,
        )  # fmt: skip
    assert [bus.read(i, RegisterName.GOAL_POSITION, raw=True) for i in (1, 3)] == before


@pytest.mark.parametrize("confirmed", [False, True])
def test_goal_inside_range_or_towards_it_is_written(bus, confirmed):
    write_goals(bus, {1: 2048, 2: 2130}, {1: (2048, 2048), 2: (2000, 2100)},
                reached=lambda _: (2150,), confirmed=confirmed)  # fmt: skip
    assert [bus.read(i, RegisterName.GOAL_POSITION, raw=True) for i in (1, 2)] == [2048, 2130]


@pytest.mark.full
def test_only_one_source_module_writes_goal_registers():
    package = Path(ikservo.__file__).parent
    found = {
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") in WRITES
        if any("GOAL_POSITION" in ast.unparse(each) for each in node.args)
    }
    assert found == {"hardware/goal_writing.py"}
