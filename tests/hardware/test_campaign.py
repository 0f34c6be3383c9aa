"""No wrong reply is returned as good, and every loss is reported, however bad the line."""

from __future__ import annotations

import sys

import pytest

from ikservo.errors import ServoSilentError
from ikservo.registers import RegisterName

from .campaign import (
    DAMAGED,
    DOUBLED,
    DYNAMIXEL,
    EVERYTHING,
    FEETECH,
    LATE,
    ours,
    ours_moving,
    stock,
)
from .factories import add_faults, make_bus

FAMILIES = {"Feetech": FEETECH, "Dynamixel": DYNAMIXEL}
FAULTS = {"late": LATE, "doubled": DOUBLED, "damaged": DAMAGED, "everything": EVERYTHING}

both = pytest.mark.parametrize("models", FAMILIES.values(), ids=FAMILIES)


@pytest.mark.sample(3)
@both
@pytest.mark.parametrize("faults", FAULTS.values(), ids=FAULTS)
def test_faulty_bus_never_returns_wrong_value(models, faults):
    outcome = ours(models, 1_500, seed=1, faults=faults)
    assert outcome.wrong == 0
    assert outcome.lost < 0.05 * outcome.reads


@both
def test_stale_position_is_never_returned_as_present_one(models):
    outcome = ours_moving(models, 1_500, seed=1)
    assert outcome.wrong == 0
    assert outcome.lost < 0.05 * outcome.reads


@both
def test_every_lost_reply_is_reported(models):
    bus = make_bus(models, retries=0)
    add_faults(bus, ("silent", {"probability": 0.05, "count": 25}))
    lost = 0
    for _ in range(1_000):
        lost += _is_lost(bus)
    assert lost == 25


def _is_lost(bus):
    try:
        bus.read(1, RegisterName.PRESENT_POSITION)
    except ServoSilentError:
        return True
    return False


@both
def test_flipped_bits_do_not_yield_wrong_values(models):
    outcome = ours(models, 1_000, seed=2, faults=[("flipped", {"probability": 0.05, "bits": 2})])
    assert outcome.wrong == 0


@both
def test_healthy_bus_has_no_loss_and_no_retry(models):
    outcome = ours(models, 1_000, seed=3, faults=[])
    assert (outcome.wrong, outcome.lost, outcome.retried) == (0, 0, 0)


@both
def test_vendor_sdk_returns_wrong_values_on_same_faulty_bus(models):
    outcome = stock(models, 500, seed=1)
    assert outcome.wrong > 0


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@both
def test_half_million_reads_per_family_have_no_wrong_value(models, capsys):
    outcome, theirs = ours(models, 500_000, seed=7), stock(models, 20_000, seed=7)
    with capsys.disabled():
        sys.stdout.write(f"\nours:  {outcome}\nstock: {theirs}\n")
    assert outcome.wrong == 0


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@both
def test_quarter_million_reads_while_moving_have_no_wrong_value(models, capsys):
    outcome = ours_moving(models, 250_000, seed=7)
    with capsys.disabled():
        sys.stdout.write(f"\nmoving: {outcome}\n")
    assert outcome.wrong == 0
