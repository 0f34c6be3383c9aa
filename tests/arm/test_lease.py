"""The lease of control: one operator, numbered and dated messages."""

import pytest

from ikservo.errors import LeaseLostError, RefusedError
from ikservo.serving.lease import ArmLease
from servosim.clock import VirtualClock


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def lease(clock):
    return ArmLease(clock)


def after(clock, seconds):
    clock.sleep_until(clock.now_s() + seconds)
    return clock.now_s()


def test_second_operator_is_refused_with_name_of_first_operator(lease):
    lease.acquire("ada on laptop")
    with pytest.raises(RefusedError, match="ada on laptop controls the arm"):
        lease.acquire("bob on desk")


def test_released_control_lease_can_be_acquired_again(lease):
    first = lease.acquire("ada")
    assert lease.release(first.lease)
    assert lease.acquire("bob").lease != first.lease


def test_releasing_unknown_lease_changes_nothing(lease):
    lease.acquire("ada")
    assert not lease.release("00")
    assert lease.holder.operator == "ada"


@pytest.mark.parametrize(
    ("number", "age_s", "counts"),
    [(6, 0.0, True), (6, 0.29, True), (6, 0.31, False), (5, 0.0, False), (4, 0.0, False),
     (6, -0.29, True), (6, -0.31, False)],
)  # fmt: skip
def test_setpoint_is_accepted_if_newer_and_under_300_ms_old(lease, clock, number, age_s, counts):
    held = lease.acquire("ada").lease
    now_s = after(clock, 10.0)
    assert lease.accept_setpoint(held, 5, now_s)
    assert lease.accept_setpoint(held, number, now_s - age_s) is counts
    assert lease.dropped == (not counts)


def test_setpoints_sent_under_an_earlier_lease_are_dropped(lease, clock):
    old = lease.acquire("ada").lease
    lease.release(old)
    lease.acquire("ada")
    assert not lease.accept_setpoint(old, 1, clock.now_s())


def test_dropped_setpoint_does_not_refresh_lease(lease, clock):
    held = lease.acquire("ada").lease
    after(clock, 0.5)
    lease.accept_setpoint(held, 1, clock.now_s() - 0.4)
    assert lease.silence_s() == pytest.approx(0.5)
    lease.accept_setpoint(held, 1, clock.now_s())
    assert lease.silence_s() == 0.0


@pytest.mark.parametrize(
    ("own", "number", "age_s", "text"),
    [(False, 3, 0.0, "does not control"), (True, 2, 0.0, "repeated"), (True, 3, 0.4, "0.4 s")],
)
def test_control_lease_refuses_foreign_repeated_or_late_request(
    lease, clock, own, number, age_s, text
):
    held = lease.acquire("ada").lease
    now_s = after(clock, 1.0)
    lease.check_request(held, 2, now_s)
    with pytest.raises(RefusedError, match=text):
        lease.check_request(held if own else "ab", number, now_s - age_s)


def test_motion_is_refused_after_loss_of_lease(lease):
    held = lease.acquire("ada").lease
    with lease.motion(held):
        assert lease.moving.operator == "ada"
        lease.release(held)
        assert lease.moving is not None  # it is still to be stopped
    assert lease.moving is None
    with pytest.raises(LeaseLostError), lease.motion(held):
        pass


def test_closed_control_lease_refuses_motions_and_operators(lease):
    held = lease.acquire("ada").lease
    lease.close()
    with pytest.raises(LeaseLostError), lease.motion(held):
        pass
    with pytest.raises(RefusedError, match="is ending"):
        lease.acquire("bob")


def test_taking_over_control_ends_previous_lease(lease):
    first = lease.acquire("page 1").lease
    second = lease.acquire("page 2", take_over=True).lease
    assert (lease.is_held_by(first), lease.is_held_by(second)) == (False, True)
    assert not lease.release(first)
    assert lease.holder.operator == "page 2"


def test_lease_can_only_be_refreshed_by_its_holder(lease, clock):
    assert lease.is_silent  # nobody was heard yet
    held = lease.acquire("page 1").lease
    after(clock, 0.29)
    assert not lease.is_silent
    assert not lease.refresh("")
    after(clock, 0.02)
    assert lease.is_silent
    assert lease.refresh(held)
    assert not lease.is_silent


def test_released_lease_cannot_be_refreshed(lease, clock):
    held = lease.acquire("page 1").lease
    lease.release(held)
    after(clock, 0.4)
    assert lease.is_silent
    assert not lease.refresh(held)
