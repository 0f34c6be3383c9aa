"""Check that the default suite's description of LeRobot's classes is correct."""

import importlib
import inspect
import sys
from pathlib import Path

import pytest

STUB = Path(__file__).parents[3] / "tests" / "integrations" / "stub"
NAMES = [
    ("lerobot.robots", "Robot"),
    ("lerobot.teleoperators", "Teleoperator"),
]


def described(module, name):
    """Return the class as the default suite describes it."""
    kept = {key: sys.modules.pop(key) for key in list(sys.modules) if key.startswith("lerobot")}
    sys.path.insert(0, str(STUB))
    try:
        return getattr(importlib.import_module(module), name)
    finally:
        sys.path.remove(str(STUB))
        for key in [key for key in sys.modules if key.startswith("lerobot")]:
            del sys.modules[key]
        sys.modules.update(kept)


@pytest.mark.parametrize(("module", "name"), NAMES)
def test_lerobot_type_stubs_have_its_abstract_members(module, name):
    real = getattr(importlib.import_module(module), name)
    ours = described(module, name)
    assert real.__abstractmethods__ == ours.__abstractmethods__
    for member in real.__abstractmethods__:
        one, other = getattr(real, member), getattr(ours, member)
        assert isinstance(one, property) == isinstance(other, property), member
        if not isinstance(one, property):
            assert list(inspect.signature(one).parameters) == list(
                inspect.signature(other).parameters
            )


def test_lerobot_finds_all_plugin_types_by_distribution_name():
    from lerobot.robots import RobotConfig
    from lerobot.teleoperators import TeleoperatorConfig
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    assert "ikservo" in RobotConfig.get_known_choices()
    assert {"ikservo_leader", "ikservo_page"} <= TeleoperatorConfig.get_known_choices().keys()


def test_lerobot_factories_make_robot_and_both_teleoperators():
    from lerobot.robots import make_robot_from_config
    from lerobot.teleoperators import make_teleoperator_from_config

    from lerobot_robot_ikservo import (
        IkservoLeader,
        IkservoLeaderConfig,
        IkservoPage,
        IkservoPageConfig,
        IkservoRobot,
        IkservoRobotConfig,
    )

    robot = make_robot_from_config(IkservoRobotConfig(id="a", port="sim"))
    leader = make_teleoperator_from_config(IkservoLeaderConfig(id="a", port="sim"))
    page = make_teleoperator_from_config(IkservoPageConfig(id="a"))
    kinds = [type(device) for device in (robot, leader, page)]
    assert kinds == [IkservoRobot, IkservoLeader, IkservoPage]
