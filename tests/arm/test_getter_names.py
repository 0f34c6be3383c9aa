"""Reading a property asks no servo and changes nothing."""

import ast
import re
from contextlib import suppress
from pathlib import Path

import pytest

import ikservo
from ikservo.errors import IkservoError, RefusedError
from tests.arm.simulated import clock_of, motion_runner, transport_of

PACKAGE = Path(ikservo.__file__).parent
READS = {"read", "bulk_read", "sync_read", "read_register", "read_registers"}
# What begins with one of these says that it does something.
VERBS = re.compile(r"_*(read|measure|await|command|choose|store)(_|$)")
QUANTITY = re.compile(r"\w*_(s|rad|m|c|v|ticks)$")


def functions(folder):
    """Return (name of file and function, syntax tree) of all functions below a folder."""
    for path in sorted((PACKAGE / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                yield f"{path.relative_to(PACKAGE)}: {node.name}", node


def is_property(function):
    return any(isinstance(d, ast.Name) and d.id == "property" for d in function.decorator_list)


def is_predicate(function):
    returns = ast.unparse(function.returns) if function.returns else ""
    return returns.startswith("bool") and not VERBS.match(function.name)


def reads_a_servo(function):
    called = (node.func for node in ast.walk(function) if isinstance(node, ast.Call))
    return any(getattr(f, "attr", getattr(f, "id", "")) in READS for f in called)


def assigns_to_itself(function):
    for node in ast.walk(function):
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if any(isinstance(t, ast.Attribute) and ast.unparse(t.value) == "self" for t in targets):
            return True
    return False


def test_predicates_and_properties_do_not_read_servos():
    asked = [f for f in functions("control") if is_property(f[1]) or is_predicate(f[1])]
    assert len(asked) > 10
    assert [place for place, function in asked if reads_a_servo(function)] == []


@pytest.mark.parametrize("folder", ["control", "arm", "guard", "motion"])
def test_functions_named_by_quantity_have_no_side_effects(folder):
    asked = [
        (place, function)
        for place, function in functions(folder)
        if is_property(function)
        or (QUANTITY.match(function.name) and not VERBS.match(function.name))
    ]
    assert asked
    assert [place for place, function in asked if assigns_to_itself(function)] == []


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim") as machine:
        yield machine


def test_properties_of_newly_opened_arm_send_no_packets(arm, monkeypatch):
    sent = []
    monkeypatch.setattr(type(transport_of(arm)), "write", lambda _, data: sent.append(data))
    read = [(part, name) for part in parts_of(arm) for name in properties(part)]
    for part, name in read:
        with suppress(IkservoError):
            getattr(part, name)
    assert len({type(part) for part, _ in read}) > 10
    assert sent == []


def parts_of(whole):
    """Return an object of ikservo and every one that it contains, at any depth."""
    found, new = {}, [whole]
    while new:
        part = new.pop()
        if type(part).__module__.startswith("ikservo.") and id(part) not in found:
            found[id(part)] = part
            new += getattr(part, "__dict__", {}).values()
    return list(found.values())


def properties(part):
    return [n for n in dir(type(part)) if isinstance(getattr(type(part), n, None), property)]


def test_control_cycle_time_is_measured_once_at_torque_on(arm):
    with pytest.raises(RefusedError, match="torque"):
        _ = motion_runner(arm).loop.cycle_time_s
    arm.enable()
    measured_s = motion_runner(arm).loop.cycle_time_s
    now_s = clock_of(arm).now_s()
    assert (motion_runner(arm).loop.cycle_time_s, clock_of(arm).now_s()) == (measured_s, now_s)
    assert 0.002 <= measured_s <= 0.010
