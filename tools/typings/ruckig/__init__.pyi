"""The part of ruckig that ikservo calls; the wheel carries no types."""

from enum import Enum

class RuckigError(RuntimeError): ...

class Result(Enum):
    Working = 0
    Finished = 1

class Synchronization(Enum):
    Time = 0
    Phase = 2
    No = 3

class ControlInterface(Enum):
    Position = 0
    Velocity = 1

class InputParameter:
    current_position: list[float]
    current_velocity: list[float]
    current_acceleration: list[float]
    target_position: list[float]
    target_velocity: list[float]
    target_acceleration: list[float]
    max_velocity: list[float]
    max_acceleration: list[float]
    max_jerk: list[float]
    control_interface: ControlInterface
    synchronization: Synchronization

    def __init__(self, degrees_of_freedom: int) -> None: ...

class BrakeProfile:
    duration: float
    t: list[float]
    p: list[float]
    v: list[float]
    a: list[float]
    j: list[float]

class Profile:
    t: list[float]
    p: list[float]
    v: list[float]
    a: list[float]
    j: list[float]
    brake: BrakeProfile

class Trajectory:
    duration: float
    profiles: list[list[Profile]]

    def __init__(self, degrees_of_freedom: int) -> None: ...
    def at_time(self, time: float) -> tuple[list[float], list[float], list[float]]: ...

class Ruckig:
    def __init__(self, degrees_of_freedom: int) -> None: ...
    def calculate(self, input: InputParameter, trajectory: Trajectory) -> Result: ...  # noqa: A002
