"""The options of robot and teleoperators, as LeRobot's command line takes them."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig

__all__ = ["ACTIONS", "IkservoLeaderConfig", "IkservoPageConfig", "IkservoRobotConfig"]

ACTIONS = ("joint", "ee", "ee_delta")


@RobotConfig.register_subclass("ikservo")
@dataclass(kw_only=True)
class IkservoRobotConfig(RobotConfig):
    """``--robot.type=ikservo``.

    Attributes:
        arm: A name in ikservo's catalogue, or a path to an arm file.
        port: A serial port, ``sim`` for the simulated arm, or empty for the only adapter.
        action: What an action is: ``joint`` positions, the pose ``ee`` of the tip, or its steps
            ``ee_delta`` as of ``keyboard_ee`` and ``gamepad``.
        speed: The arm's speed class: slow, normal or fast.
        step_m: How far a step of 1 moves the tip in a frame, metres (``ee_delta``).
        gripper_step: How far it moves the gripper in a frame, percent (``ee_delta``).
        on_exit: ``hold`` leaves torque on at disconnect, ``relax`` lowers the arm first.
        lerobot_calibration: LeRobot's id of the arm, or its file: what ``calibrate`` imports;
            empty for a calibration by hand.
        assume_yes: Answer yes to the questions of ``calibrate``.
        observe_tip: Observe the pose of the tip, ``ee.x`` to ``ee.wz``, beside the joints.
        cameras: LeRobot's cameras by name.
    """

    arm: str = "so101"
    port: str = ""
    action: str = "joint"
    speed: str = "fast"
    step_m: float = 0.002
    gripper_step: float = 2.0
    on_exit: str = "hold"
    lerobot_calibration: str = ""
    assume_yes: bool = False
    observe_tip: bool = False
    cameras: dict[str, CameraConfig] = field(default_factory=dict[str, CameraConfig])

    def __post_init__(self) -> None:
        """Check the choices; LeRobot checks the cameras.

        Raises:
            ValueError: One is none of those that exist.
        """
        super().__post_init__()
        _check_choice("action", self.action, ACTIONS)
        _check_choice("on_exit", self.on_exit, ("hold", "relax"))


@TeleoperatorConfig.register_subclass("ikservo_leader")
@dataclass(kw_only=True)
class IkservoLeaderConfig(TeleoperatorConfig):
    """``--teleop.type=ikservo_leader``: an arm that a hand guides.

    Attributes:
        arm: A name in ikservo's catalogue, or a path to an arm file.
        port: A serial port, ``sim``, or empty for the only adapter.
        lerobot_calibration: As of the robot.
        assume_yes: As of the robot.
    """

    arm: str = "so101"
    port: str = ""
    lerobot_calibration: str = ""
    assume_yes: bool = False


@TeleoperatorConfig.register_subclass("ikservo_page")
@dataclass(kw_only=True)
class IkservoPageConfig(TeleoperatorConfig):
    """``--teleop.type=ikservo_page``: a simulated arm that is dragged in a browser leads.

    Attributes:
        arm: A name in ikservo's catalogue, or a path to an arm file.
        pose: The pose in which the simulated arm starts; the robot goes there first.
        listen: The IP address at which the page is served.
        http_port: The port of the page, 0 for any that is free.
    """

    arm: str = "so101"
    pose: str = "home"
    listen: str = "127.0.0.1"
    http_port: int = 8420


def _check_choice(option: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ValueError(f"{option} is {value!r}; it can be {', '.join(known)}.")
