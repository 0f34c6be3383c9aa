"""Homing offsets, which place a servo's encoder wrap-around outside the joint's range.

A servo's *encoder tick* is its sensor reading without the homing offset, modulo a revolution: it
depends on how the horn is mounted and not on any register. The present position that the servo
reports is

- Feetech STS: ``present = (encoder - offset) mod 4096`` with ``|offset| <= 2047``, so the offset
  moves the wrap-around outside the joint's travel;
- Dynamixel in position mode: ``present = encoder + offset``. Only ``|offset| <= 1024`` takes
  effect; it shifts the count but leaves the wrap-around at encoder tick 0. Travel across the
  wrap-around requires the extended (multi-turn) mode; the revolution is then determined again
  whenever the arm is opened.
"""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.calibration.joint_map import Encoder, wrapped_difference
from ikservo.errors import CalibrationError
from ikservo.registers import Family

MAX_STS_OFFSET = 2047  # sign and 11 bits
MAX_X_OFFSET = 1024  # larger offsets are ignored in position mode (e-manual, Homing Offset(20))
_MIN_CLEARANCE = 64  # preferred distance between wrap-around and travel, ticks


@dataclass(frozen=True, slots=True)
class TickRange:
    """Range of a joint, in encoder ticks unwrapped across the wrap-around."""

    low: int
    high: int

    @property
    def width(self) -> int:
        """The number of ticks between the ends."""
        return self.high - self.low


@dataclass(frozen=True, slots=True)
class Homing:
    """Homing settings of a servo.

    Attributes:
        offset: The value for the homing offset register.
        extended: Whether the servo must count more than one revolution.
        shift: Unwrapped encoder tick minus reported tick.
    """

    offset: int
    extended: bool
    shift: int


def encoder_tick(family: Family, present: int, offset: int, encoder: Encoder) -> int:
    """Compute the encoder tick from a servo's present position and homing offset."""
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
    """Choose the homing settings for a joint's travel; keep the present settings if possible.

    The travel is in encoder ticks, unwrapped. ``counts_on`` is True for a Dynamixel in multi-turn
    mode.

    Raises:
        CalibrationError: The travel is a revolution or more, or crosses a wrap-around that cannot
            be moved.
    """
    if travel.width > encoder.ticks - 2:  # a tick must separate the ends of the travel
        raise CalibrationError(
            f"{joint}: its travel of {travel.width} ticks is more than one turn ({encoder.ticks}).",
            f"Is a horn loose? For a joint without end stops: --continuous {joint}",
        )
    if not encoder.wraps:
        return _check_fixed_homing(joint, travel, encoder)
    if family is Family.FEETECH_STS:
        return _choose_sts_homing(travel, offset, encoder.ticks)
    if family is Family.DYNAMIXEL_2:
        return _choose_x_homing(travel, offset, encoder.ticks, counts_on)
    return _check_fixed_homing(joint, travel, encoder)


def _choose_sts_homing(travel: TickRange, offset: int, ticks_per_turn: int) -> Homing:
    """Keep the offset if the wrap-around is outside the travel; otherwise, centre the travel."""
    margin = (ticks_per_turn - 1 - travel.width) // 2
    clear = min(_MIN_CLEARANCE, margin)
    low = (travel.low - offset) % ticks_per_turn
    highest = ticks_per_turn - 1 - travel.width - clear
    if abs(offset) > MAX_STS_OFFSET or not clear <= low <= highest:
        centred = wrapped_difference(0, travel.low - margin, ticks_per_turn)
        # The offsets -2048 and 2048 are equivalent, and neither is possible: use a tick less.
        offset = MAX_STS_OFFSET if centred < -MAX_STS_OFFSET else centred
        low = (travel.low - offset) % ticks_per_turn
    return Homing(offset, False, travel.low - low)


def _choose_x_homing(
    travel: TickRange, offset: int, ticks_per_turn: int, counts_on: bool
) -> Homing:
    low = travel.low % ticks_per_turn
    if counts_on or low + travel.width > ticks_per_turn - 1:
        middle = (travel.low + travel.high) // 2
        return Homing(offset, True, middle - (middle + offset) % ticks_per_turn)
    fits = low + offset >= 0 and low + travel.width + offset <= ticks_per_turn - 1
    kept = offset if abs(offset) <= MAX_X_OFFSET and fits else 0
    return Homing(kept, False, travel.low - low - kept)


def _check_fixed_homing(joint: str, travel: TickRange, encoder: Encoder) -> Homing:
    low = travel.low % encoder.ticks if encoder.wraps else travel.low
    if low < 0 or low + travel.width > encoder.ticks - 1:
        raise CalibrationError(
            f"{joint}: its travel crosses the encoder's wrap-around; this servo has no homing "
            "offset to shift it.",
            "Remount the horn a few teeth further, so that the travel does not cross it.",
        )
    return Homing(0, False, travel.low - low)
