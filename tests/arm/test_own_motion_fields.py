"""Fields of an app's motions: plain types and checks of their own."""

from dataclasses import dataclass

import pytest

from ikservo.arm.own_motion import OwnMotion
from ikservo.errors import BadValueError


@dataclass(frozen=True)
class Wave(OwnMotion[None]):
    times: int = 3
    angle_rad: float = 0.2

    def run(self, arm, on_progress):
        pass

    def end(self, context, start):
        return start


@dataclass(frozen=True)
class Unchecked(Wave):
    joints: list = ()


def test_user_defined_motion_accepts_fields_of_basic_types():
    assert Wave(times=2, angle_rad=1).times == 2


@pytest.mark.parametrize("fields", [{"times": 2.5}, {"times": True}, {"angle_rad": "a"}])
def test_user_defined_motion_refuses_field_of_wrong_type(fields):
    with pytest.raises(BadValueError, match=next(iter(fields))):
        Wave(**fields)


def test_user_defined_motion_needs_checkable_field_types():
    with pytest.raises(TypeError, match=r"Unchecked\.joints needs an annotated type"):
        Unchecked()
