"""If the network fails in mid-motion, the arm holds, and old goals are never executed."""

import contextlib
import itertools
import random

import pytest

import ikservo
from ikservo.errors import IkservoError, PortLostError, RefusedError
from ikservo.guard.dead_man import DEAD_MAN_TIMEOUT_S
from tests.apps.remote.conftest import until
from tests.apps.remote.cutting_proxy import CUTS, CuttingProxy
from tests.arm.simulated import registers

SEED = 21


@pytest.fixture
def proxy(served):
    through = CuttingProxy(served.port)
    yield through
    through.close()


def stream_until_cut(served, proxy, how, dice):
    """Stream goals through the proxy, cut it at a random one, continue until the arm stops."""
    arm = ikservo.open_arm("so101", port=f"zenoh:desk@127.0.0.1:{proxy.port}")
    start = arm.where()["wrist_roll"].position_rad
    left = dice.randrange(15, 60)
    with contextlib.suppress(IkservoError), arm.stream(speed="fast", rate_hz=100) as stream:
        for k in itertools.count():
            stream.send({"wrist_roll": start + 0.004 * min(k, 200)})
            left -= served.server.lease.moving is not None
            if left == 0:
                proxy.cut(how)
                served.server.lease.timeout_s = DEAD_MAN_TIMEOUT_S
            if served.arm.stop_reason is not None:
                break
    assert left <= 0, "the arm was stopped before the cut"
    return arm


@pytest.mark.full
@pytest.mark.sample(3)
@pytest.mark.parametrize("how", CUTS)
def test_network_cut_during_motion_makes_arm_hold(served, proxy, how):
    dice = random.Random(f"{SEED} {how}")
    arm = stream_until_cut(served, proxy, how, dice)
    until(lambda: served.server.lease.moving is None)
    assert served.arm.stop_reason is not None
    held = registers(served.arm, "goal_position")
    dropped = served.server.lease.dropped
    proxy.restore()
    if how == "delay":  # goals of before and after the cut arrive at last
        until(lambda: served.server.lease.dropped > dropped)
    assert registers(served.arm, "goal_position") == held
    with pytest.raises(RefusedError, match="was stopped"):
        served.arm.move_joints({"wrist_roll": 0.0})
    goals = registers(served.arm, "goal_position")
    assert all(abs(goals[i] - held[i]) <= 2 for i in held)  # where the joints are
    arm.close()
    until(lambda: served.server.lease.holder is None)


def test_lost_connection_error_says_what_to_check(served, proxy, monkeypatch):
    arm = ikservo.open_arm("so101", port=f"zenoh:desk@127.0.0.1:{proxy.port}")
    monkeypatch.setattr("ikservo.apps.remote.client_connection._QUICK_S", 0.1)
    proxy.close()
    with pytest.raises(PortLostError, match="Is that machine on and reachable"):
        arm.where()
    arm.close()


def test_remote_request_is_repeated_after_reconnection(served, proxy):
    arm = ikservo.open_arm("so101", port=f"zenoh:desk@127.0.0.1:{proxy.port}")
    proxy.cut("hang up")
    assert arm.where().names == served.arm.joint_names
    arm.close()
