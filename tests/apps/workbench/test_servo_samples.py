"""Samples of servos: every model has the plotted values, and samples are evenly spaced."""

from itertools import islice

import pytest

from ikservo.apps.workbench.servo_samples import live_registers, sample_registers
from ikservo.errors import BusError
from ikservo.registers import MODELS
from servosim.faults import Fault
from tests.hardware.factories import make_bus, simulated_servos


@pytest.mark.parametrize("model", MODELS)
def test_every_servo_model_has_six_live_registers_at_least(model):
    names = [register.name for register in live_registers(MODELS[model])]
    assert len(set(names)) == len(names) >= 6
    assert names[:2] == ["goal_position", "present_position"]


def test_servo_samples_match_registers_and_are_evenly_spaced():
    bus = make_bus({1: "STS3215", 7: "XL430-W250"})
    watched = {i: live_registers(servo.table) for i, servo in bus.servos.items()}
    samples = list(islice(sample_registers(bus, watched, 0.05), 5))
    assert [one.time_s for one in samples] == pytest.approx([0, 0.05, 0.1, 0.15, 0.2], abs=2e-3)
    for servo_id, values in samples[-1].values.items():
        held = simulated_servos(bus)[servo_id]
        assert {r: r.to_value(held.read(r.name)) for r in watched[servo_id]} == values


@pytest.mark.parametrize(("period_s", "count"), [(0.05, 5), (0.15, 2), (1e300, 1), (1e-320, None)])
def test_servo_sampling_ends_after_its_duration(period_s, count):
    bus = make_bus({1: "STS3215"})
    since_s = bus.clock.now_s()
    rows = list(sample_registers(bus, {1: live_registers(MODELS["STS3215"])}, period_s, 0.2))
    assert len(rows) == (count or len(rows))
    assert rows[-1].time_s <= 0.202
    assert bus.clock.now_s() - since_s < 0.3


def test_sampling_of_silent_servo_raises_bus_error():
    bus = make_bus({1: "STS3215"})
    bus.port.transport.line.faults.add(Fault("silent", id=1))
    with pytest.raises(BusError):
        next(sample_registers(bus, {1: live_registers(MODELS["STS3215"])}, 0.1))
