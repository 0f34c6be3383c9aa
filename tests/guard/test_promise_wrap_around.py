"""M6: a joint's calibrated range never contains the tick at which its servo's count wraps."""

import numpy as np
import pytest

from ikservo.calibration import JointMap, Limits
from ikservo.calibration.homing import TickRange, choose_homing
from ikservo.calibration.joint_map import Encoder
from ikservo.guard import DrivenJoint
from ikservo.registers import Family

TURN, MAGNET = 4096, Encoder(4096, 4096.0)


def reported(family, bare, homing):
    """Return the reading of a servo at unwrapped ticks, as its data sheet describes."""
    if family is Family.FEETECH_STS:
        return (bare - homing.offset) % TURN
    return bare % TURN + homing.offset


def seams_inside(lows, widths, offsets):
    """Return the number of ranges, and of those in which a servo's count would jump."""
    cases = jumps = 0
    for width in widths:
        for low in lows:
            travel = TickRange(low, low + width)
            bare = np.linspace(travel.low, travel.high, 9).astype(int)
            for offset in offsets:
                for family in (Family.FEETECH_STS, Family.DYNAMIXEL_2):
                    homing = choose_homing("elbow", family, travel, offset, MAGNET)
                    cases += 1
                    if not homing.extended:  # a multi-turn count does not wrap
                        reported_ticks = reported(family, bare, homing)
                        jumps += not np.array_equal(reported_ticks, bare - homing.shift)
    return cases, jumps


def test_sensor_count_never_wraps_inside_calibrated_range():
    cases, jumps = seams_inside(range(0, TURN, 127), (2, 800, 2047, 3000, 4094),
                                range(-2047, 2048, 311))  # fmt: skip
    assert (cases, jumps) == (33 * 5 * 14 * 2, 0)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_sensor_count_never_wraps_in_campaign():
    cases, jumps = seams_inside(range(0, TURN, 13), (2, 800, 2047, 3000, 4094),
                                range(-2047, 2048, 13))  # fmt: skip
    print(f"{cases} travels, {jumps} jumps")  # noqa: T201  # a number to keep
    assert jumps == 0


@pytest.mark.parametrize("sign", [1, -1])
def test_tick_to_position_conversion_round_trips_for_whole_turn(sign):
    joint_map = JointMap.revolute("elbow", 3, sign, 2048.37, TURN)
    ends = sorted((joint_map.position(1000), joint_map.position(3000)))
    driven = DrivenJoint(joint_map, Limits.of("elbow", *ends, "hand sweep"), 1.0)
    ticks = [driven.tick(joint_map.position(tick)) for tick in range(TURN)]
    assert ticks == list(range(TURN))
    assert driven.tick_range == (1000, 3000)
