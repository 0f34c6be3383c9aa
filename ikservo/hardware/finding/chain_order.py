"""What silence most likely means on a chain of servos: where along the cable it begins."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from ikservo.hardware.servo import ServoSpec

__all__ = ["silence_hint"]


def silence_hint(
    chain: Iterable[ServoSpec], answering: Collection[int], silent: Collection[int]
) -> str:
    """Return what to look at, from who answers and who does not.

    Args:
        chain: The servos in the order of the cable.
        answering: Ids that gave an answer.
        silent: Ids that did not.
    """
    asked = [servo for servo in chain if servo.id in answering or servo.id in silent]
    if not answering:
        return (
            "No servo answers. Check the power supply and the first cable; "
            "to try every baud rate: ikservo doctor"
        )
    first = next(place for place, servo in enumerate(asked) if servo.id in silent)
    mute = [servo.id for servo in asked if servo.id in silent]
    if first and all(servo.id in silent for servo in asked[first:]):
        heard = [servo.id for servo in asked if servo.id in answering]
        return (
            f"{_silent(mute)}, {_listed(heard)} {'answers' if len(heard) == 1 else 'answer'}: "
            f"check the cable from {_name(asked[first - 1])} to {_name(asked[first])}."
        )
    its = "its" if len(mute) == 1 else "their"
    return f"{_silent(mute)}, the others do. Check {its} connector, id and baud rate."


def _silent(servo_ids: Sequence[int]) -> str:
    one = len(servo_ids) == 1
    return f"Servo{'' if one else 's'} {_listed(servo_ids)} {'does' if one else 'do'} not answer"


def _name(servo: ServoSpec) -> str:
    return servo.name or str(servo)


def _listed(servo_ids: Sequence[int]) -> str:
    ids = sorted(servo_ids)
    if len(ids) > 2 and ids == list(range(ids[0], ids[-1] + 1)):
        return f"{ids[0]} to {ids[-1]}"
    *most, last = map(str, ids)
    return f"{', '.join(most)} and {last}" if most else last
