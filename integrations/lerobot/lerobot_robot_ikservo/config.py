"""Options of the robot and the teleoperators on LeRobot's command line."""

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
    """Options of ``--robot.type=ikservo``.

    Attributes:
        arm: A name in ikservo's catalogue, or a path to an arm file.
        port: A serial port, ``sim`` for the simulated arm, or empty for the only adapter.
        action: The kind of action: ``joint`` positions, the pose ``ee`` of the tip, or steps of the
            tip, ``ee_delta``, as from ``keyboard_ee`` and ``gamepad``.
        speed: The arm's speed class: slow, normal or fast.
        step_m: The motion of the tip per frame for a step of 1, metres (``ee_delta``).
        gripper_step: The motion of the gripper per frame for a step of 1, percent (``ee_delta``).
        on_exit: ``hold`` leaves torque on at disconnect, ``relax`` lowers the arm first.
        lerobot_calibration: The id or file of the arm in LeRobot, which ``calibrate`` imports;
            empty for a calibration by hand.
        assume_yes: Whether to answer yes to the questions of ``calibrate``.
        observe_tip: Whether to observe the pose of the tip, ``ee.x`` to ``ee.wz``, besides the
            joints.
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
            ValueError: A choice does not exist.
        """
        super().__post_init__()
        _check_choice("action", self.action, ACTIONS)
        _check_choice("on_exit", self.on_exit, ("hold", "relax"))


@TeleoperatorConfig.register_subclass("ikservo_leader")
@dataclass(kw_only=True)
class IkservoLeaderConfig(TeleoperatorConfig):
    """Options of ``--teleop.type=ikservo_leader``: an arm that is guided by hand.

    Attributes:
        arm: A name in ikservo's catalogue, or a path to an arm file.
        port: A serial port, ``sim``, or empty for the only adapter.
        lerobot_calibration: See ``IkservoRobotConfig``.
        assume_yes: See ``IkservoRobotConfig``.
    """

    arm: str = "so101"
    port: str = ""
    lerobot_calibration: str = ""
    assume_yes: bool = False


@TeleoperatorConfig.register_subclass("ikservo_page")
@dataclass(kw_only=True)
class IkservoPageConfig(TeleoperatorConfig):
    """Options of ``--teleop.type=ikservo_page``: the leader is a simulated arm in a browser.

    Attributes:
        arm: A name in ikservo's catalogue, or a path to an arm file.
        pose: The start pose of the simulated arm; the robot first moves to this pose.
        listen: The IP address at which the page is served.
        http_port: The port of the page; 0 for any free port.
    """

    arm: str = "so101"
    pose: str = "home"
    listen: str = "127.0.0.1"
    http_port: int = 8420


def _check_choice(option: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ValueError(f"{option} is {value!r}; it can be {', '.join(known)}.")
