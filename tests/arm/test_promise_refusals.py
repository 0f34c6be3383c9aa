"""M2: a meaningless request is refused completely, and no packet is sent."""

import math

import numpy as np
import pytest

import ikservo
from ikservo.errors import IkservoError
from tests.arm.random_faults import seeded
from tests.arm.seeds import few_or_many, log
from tests.arm.simulated import gate_of, line_of, servo_group
from tests.cli.fixtures_ports import change_bus, run_command

NONSENSE = [
    math.nan, math.inf, -math.inf, 1e308, -1e308, 1e9, None, "", "far", "1,5", "0.2", b"1", (), [],
    {}, [0.1], object(), 1j, np.float32("nan"), np.array(math.inf), np.array([1.0, 2.0]),
]  # fmt: skip
NO_NUMBERS = [
    math.nan,
    math.inf,
    1e308,
    "",
    "far",
    "0.2",
    [],
    (),
    [0.1],
    object(),
    1j,
    np.array([1.0, 2.0]),
]
STRANGERS = ["", "elbow", "ELBOW_FLEX", "elbow_flex ", None, 3, ("elbow_flex",)]
EACH = 100  # commands a seed


@pytest.fixture(scope="module")
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        machine.enable()
        yield machine


class Packets:
    """Counts the packets of the host."""

    def __init__(self, line):
        self.count = 0
        line.witnesses.append(self)

    def on_frame(self, _at_s, _frame, _framing):
        self.count += 1

    def on_reply(self, _at_s, _servo, _data):
        pass


@few_or_many(1, 1000)
def test_refused_method_call_sends_no_packets(arm, seeds, capsys):
    packets = Packets(line_of(arm))
    for seed in seeds:
        dice = seeded(seed)
        for _ in range(EACH):
            command = dice.choice(COMMANDS)
            with pytest.raises(IkservoError):
                command(arm, dice)
    log(capsys, f"{EACH * len(seeds):,} refused commands: {packets.count} packets")
    assert packets.count == 0


def joint(arm, dice):
    """Request a valid position of one joint and an invalid one of another."""
    asked = {"wrist_roll": 0.1, dice.choice(arm.chain.names): dice.choice(NONSENSE)}
    return arm.move_joints(asked, speed=dice.choice(("slow", "normal")))


def beyond(arm, dice):
    """Request the first tick past a limit."""
    driven = dice.choice(servo_group(arm).driven_joints)
    end, outwards = dice.choice((0, 1)), dice.choice((1, 2, 50, 4096))
    tick = driven.position_range[end] + (2 * end - 1) * outwards * driven.joint_map.unit_per_tick
    return arm.move_joints({driven.joint: tick})


def stranger(arm, dice):
    return arm.move_joints({dice.choice(STRANGERS): 0.1, "wrist_roll": 0.1})


def point(arm, dice):
    """Request a point with an invalid coordinate, or with too few or too many."""
    at = [0.2, 0.0, 0.2]
    at[dice.randrange(3)] = dice.choice(NONSENSE)
    move = dice.choice((arm.move_to, arm.move_line, lambda p: arm.move_through([(0.2, 0, 0.2), p])))
    return move(dice.choice((at, at[:2], [*at, 0.1], dice.choice(NONSENSE))))


def skill(arm, dice):
    what = dice.choice(NO_NUMBERS)
    ask = dice.choice((
        lambda: arm.pose(dice.choice([*STRANGERS, []])),
        lambda: arm.gripper(what),
        lambda: arm.gripper("open", force=what),
        lambda: arm.jog("elbow_flex", what, wanted=lambda: True),
        lambda: arm.jog(dice.choice(STRANGERS), 0.1, wanted=lambda: True),
        lambda: arm.move_joints({"wrist_roll": 0.1}, speed=what),
    ))  # fmt: skip
    return ask()


def tick(arm, dice):
    """Send ticks to the gate directly, without all other checks."""
    names = servo_group(arm).names
    ticks = dict.fromkeys(names) | {"wrist_roll": 2048}
    ticks[dice.choice(arm.chain.names)] = dice.choice([*NONSENSE, 2048.0, -1])
    return gate_of(arm).pass_goals(list(ticks.values()))


COMMANDS = [joint, beyond, stranger, point, skill, tick]


# --- the same from a terminal: every command opens an arm of its own


WORDS = ["nan", "inf", "-inf", "1e308", "far", "1,5", "", "0x10", "1e9", "--"]


@few_or_many(3, 300)
def test_refused_command_writes_nothing_to_servos(seeds, capsys, monkeypatch):
    opened_lines = []
    change_bus(monkeypatch, lambda line: opened_lines.append(Written(line)))
    for seed in seeds:
        result = run_command(typed(seeded(seed)))
        assert result.code != 0, seed
        assert "Traceback" not in result.err, seed
    written = [words for opened in opened_lines for words in opened.words]
    log(
        capsys,
        f"{len(seeds)} refused commands, {len(opened_lines)} lines opened: {written} written",
    )
    assert written == []


class Written:
    """Records goals and torque that are written to the servos of a line."""

    def __init__(self, line):
        self.words = []
        for servo in line.world.servos:
            servo.on_write = self._watcher(servo)

    def _watcher(self, servo):
        watched = [servo.table.by_name[name] for name in ("goal_position", "torque_enable")]

        def watch(address, data):
            end = address + len(data)
            self.words += [(servo.id, row.name) for row in watched if address <= row.address < end]

        return watch


def typed(dice):
    """Return a meaningless command as a user would type it."""
    word, name = dice.choice(WORDS), dice.choice(("shoulder_pan", "elbow_flex", "gripper"))
    words = dice.choice((
        f"move 0.2 {word} 0.2",
        f"move 0.2 0 {dice.choice((5, -3, 1e6))}",
        "move 0.2 0",
        f"joints {name}={word}",
        f"joints {name}={dice.choice((400, -400, 1e5))}",
        f"joints {dice.choice(('elbow', '', 'x'))}=10",
        f"pose {word or 'nowhere'}",
        f"gripper {word}",
        f"gripper close --force {word}",
    ))  # fmt: skip
    return f"{words} --arm so101 --port sim --yes"
