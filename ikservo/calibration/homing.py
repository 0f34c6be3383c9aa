"""Homing offsets: place a servo's encoder wrap-around outside the joint's range.

A servo's *bare* tick is what its sensor says without the homing offset, modulo a turn: it
belongs to the way the horn is mounted and stays the same whatever is written. The present
position that the servo reports is

- Feetech STS: ``present = (bare - offset) mod 4096`` with ``|offset| <= 2047``, so the offset
  moves the seam to wherever the joint never goes;
- Dynamixel in position mode: ``present = bare + offset`` with ``|offset| <= 1024`` in force,
  which shifts the count but leaves the seam at bare tick 0. Where the joint goes across it only
  the extended mode serves, which counts on; the turn is then found again at each opening.
"""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.calibration.joint_map import Encoder, wrapped_difference
from ikservo.errors import CalibrationError
from ikservo.registers import Family

__all__ = ["MAX_STS_OFFSET", "MAX_X_OFFSET", "Homing", "TickRange", "choose_homing", "encoder_tick"]

MAX_STS_OFFSET = 2047  # sign and 11 bits
MAX_X_OFFSET = 1024  # more is ignored in position mode (e-manual, Homing Offset(20))
_MIN_CLEARANCE = 64  # ticks that a seam should be away from the travel, where there is room


@dataclass(frozen=True, slots=True)
class TickRange:
    """Where a joint goes, in bare ticks counted on across the seam."""

    low: int
    high: int

    @property
    def width(self) -> int:
        """Return the ticks from one end to the other."""
        return self.high - self.low


@dataclass(frozen=True, slots=True)
class Homing:
    """How a servo's count is set up.

    Attributes:
        offset: For its homing offset register.
        extended: Whether it must count on beyond one turn.
        shift: Reported tick = unwrapped bare tick - shift.
    """

    offset: int
    extended: bool
    shift: int


def encoder_tick(family: Family, present: int, offset: int, encoder: Encoder) -> int:
    """Return what the sensor alone says, from a servo's present position and homing offset."""
    if not encoder.wraps:
        return present
    return (present + offset if family is Family.FEETECH_STS else present - offset) % encoder.ticks


def choose_homing(
    joint: str,
    family: Family,
    travel: TickRange,
    offset: int,
    encoder: Encoder,
    *,
    counts_on: bool = False,
) -> Homing:
    """Return how the servo must be set up for a travel; what it holds stays if that will do.

    Args:
        joint: Its name, for messages.
        family: The servo's dialect.
        travel: Bare ticks, unwrapped.
        offset: The homing offset that the servo holds now.
        encoder: Its sensor.
        counts_on: Whether a Dynamixel is in a mode that counts on over the seam already.

    Raises:
        CalibrationError: The travel is a turn or more, or crosses a seam that cannot be moved.
    """
    if travel.width > encoder.ticks - 2:  # a tick is needed to tell the ends apart
        raise CalibrationError(
            f"{joint}: travel of {travel.width} ticks, more than one turn ({encoder.ticks}).",
            f"Is a horn loose? For a joint without end stops: --free {joint}",
        )
    if family is Family.FEETECH_STS:
        return _choose_sts_homing(travel, offset, encoder.ticks)
    if family is Family.DYNAMIXEL_2:
        return _choose_x_homing(travel, offset, encoder.ticks, counts_on)
    return _check_fixed_homing(joint, travel, encoder)


def _choose_sts_homing(travel: TickRange, offset: int, turn: int) -> Homing:
    """Keep the offset if the seam stays clear of the travel, else put the travel in the middle."""
    room = (turn - 1 - travel.width) // 2
    clear = min(_MIN_CLEARANCE, room)
    low = (travel.low - offset) % turn
    if abs(offset) > MAX_STS_OFFSET or not clear <= low <= turn - 1 - travel.width - clear:
        wanted = wrapped_difference(0, travel.low - room, turn)
        # -2048 and 2048 are one place, and neither fits; a tick beside it there is always room.
        offset = MAX_STS_OFFSET if wanted < -MAX_STS_OFFSET else wanted
        low = (travel.low - offset) % turn
    return Homing(offset, False, travel.low - low)


def _choose_x_homing(travel: TickRange, offset: int, turn: int, counts_on: bool) -> Homing:
    low = travel.low % turn
    if counts_on or low + travel.width > turn - 1:
        middle = (travel.low + travel.high) // 2
        return Homing(offset, True, middle - (middle + offset) % turn)
    fits = low + offset >= 0 and low + travel.width + offset <= turn - 1
    kept = offset if abs(offset) <= MAX_X_OFFSET and fits else 0
    return Homing(kept, False, travel.low - low - kept)


def _check_fixed_homing(joint: str, travel: TickRange, encoder: Encoder) -> Homing:
    low = travel.low % encoder.ticks if encoder.wraps else travel.low
    if low < 0 or low + travel.width > encoder.ticks - 1:
        raise CalibrationError(
            f"{joint}: its travel crosses the encoder's wrap-around; this servo cannot shift it.",
            "Remount the horn a few teeth further, so that the travel stays on one side of it.",
        )
    return Homing(0, False, travel.low - low)
