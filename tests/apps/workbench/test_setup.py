"""``ikservo setup``: a person plugs in one servo after another, and each is configured."""

import itertools
import json

import pytest

import servosim
from ikservo.apps.workbench.id_and_baud_rate import wait_for_servo
from ikservo.hardware.port import open_port
from ikservo.hardware.scan import scan_rate
from ikservo.registers import control_table
from tests.cli.fixtures_ports import change_bus, run_command
from tests.oracle import CONFIGS

pytestmark = pytest.mark.full  # the fixture takes long

NEW = {"so101": (1, 0), "koch": (1, 1)}  # id and baud code with which a servo is delivered
RETURN_DELAY = {"so101": "return_delay", "koch": "return_delay_time"}


class Operator:
    """Plugs in one new servo after another, and unplugs each when it is configured.

    Args:
        line: The simulated line; nothing is plugged in at first.
        arm: The arm of the servos.
        clumsy: Whether the third servo is plugged in five seconds before the second is unplugged.
    """

    def __init__(self, line, arm, clumsy=False):
        self.line, self.arm, self.clumsy = line, arm, clumsy
        self.servos = list(line.world.servos)
        self.wanted = [(servo.id, servo.baud) for servo in self.servos]
        self.at, self.next_s, self.ready_s = 0, 0.4, 0.0
        for servo in self.servos:
            self._make_new(servo)
            servo.powered = False

    def _make_new(self, servo):
        new_id, new_baud = NEW[self.arm]
        new = {"id": new_id, "baud_rate": new_baud, RETURN_DELAY[self.arm]: 200}
        for name, value in new.items():
            servo.memory.put(name, value)
            servo.memory.persist_value(name)

    def act(self, now_s):
        """Do the next action one second after the last one."""
        if now_s < self.next_s or self.at >= len(self.servos):
            return
        servo = self.servos[self.at]
        if not servo.powered:
            servo.power_up()
            servo.powered, self.next_s = True, now_s + 1.0
        elif (servo.id, servo.baud) != self.wanted[self.at] or not self.is_ready(servo):
            self.ready_s = now_s
        elif now_s - self.ready_s > 0.5:  # nobody is quicker than what is read back
            self.pull(servo, now_s)

    def is_ready(self, servo):
        """Return whether the servo may be unplugged: its delay is written and it is locked."""
        has_lock = "lock" in servo.table.by_name
        locked = not has_lock or servo.memory.get("lock") == 1
        return locked and servo.memory.get(RETURN_DELAY[self.arm]) == 0

    def pull(self, servo, now_s):
        self.at, self.next_s = self.at + 1, now_s + 1.0
        if self.clumsy and self.at == 2:
            self.servos[self.at].power_up()
            self.servos[self.at].powered, self.next_s = True, now_s + 1.0
            self.line.world.schedule(now_s + 5.0, servo.power_down)
        else:
            servo.powered = False


def with_operator(monkeypatch, arm, **habits):
    """Put a person at the simulated line; return the operators once it is opened."""
    operators = []

    def sit_down(line):
        operator = Operator(line, arm, **habits)
        operators.append(operator)

        def look():
            operator.act(line.world.time_s)
            line.world.schedule(line.world.time_s + 0.05, look)

        look()

    ports = change_bus(monkeypatch, sit_down)
    return operators, ports


@pytest.fixture(scope="module")
def set_up():
    """Set up both arms once; return the person and the output."""
    done = {}
    for arm, options in (("so101", "--json"), ("koch", "")):
        with pytest.MonkeyPatch.context() as monkeypatch:
            operators, _ = with_operator(monkeypatch, arm)
            result = run_command(f"setup {arm} --port sim --yes {options}")
            done[arm] = operators[0], result
    return done


@pytest.mark.sample(1)
@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_setup_writes_arm_file_values_permanently(set_up, arm):
    operator, result = set_up[arm]
    assert result.code == 0, result.err
    for servo, (servo_id, baud) in zip(operator.servos, operator.wanted, strict=True):
        kept = servo.memory.eeprom
        rows = servo.table.by_name
        assert kept[rows["id"].address] == servo_id
        assert kept[rows[RETURN_DELAY[arm]].address] == 0
        assert servo.baud == baud


def test_setup_locks_eeprom_of_each_servo(set_up):
    operator, _ = set_up["so101"]
    assert [servo.memory.get("lock") for servo in operator.servos] == [1] * 6


def test_setup_prints_what_was_written(set_up):
    _, result = set_up["koch"]
    rest = "baud_rate 1 → 3 (1000000 baud), return_delay_time 200 → 0"
    assert result.out.splitlines()[:3] == [
        f"✓ shoulder_pan (id 1): {rest}",
        f"✓ shoulder_lift (id 2): id 1 → 2, {rest}",
        f"✓ elbow_flex (id 3): id 1 → 3, {rest}",
    ]


def test_setup_json_has_one_object_per_servo(set_up):
    _, result = set_up["so101"]
    rows = [json.loads(line) for line in result.out.splitlines()]
    assert [row["joint"] for row in rows][::5] == ["shoulder_pan", "gripper"]
    assert rows[5] == {
        "schema": "ikservo/setup/1", "joint": "gripper", "id": 6, "model": "STS3215", "was_id": 1,
        "was_baud_rate": 1_000_000, "written": ["id 1 → 6", "return_delay 200 → 0"],
    }  # fmt: skip


@pytest.mark.sample(1)
@pytest.mark.parametrize("arm", ["so101", "koch", "wx250s"])
def test_simulated_servos_are_set_up_one_by_one(run_cli, arm):
    result = run_cli(f"setup {arm} --port sim:?hand=setup --yes")
    assert result.code == 0, result.err
    first, *others = result.out.splitlines()
    assert "id 9 → 1" in first
    assert all(f"id 1 → {servo_id}" in line for servo_id, line in enumerate(others, start=2))
    assert "More than one servo" not in result.err  # one servo was listed twice


def test_setup_names_joint_and_asks_to_unplug(set_up):
    _, result = set_up["koch"]
    assert "3 of 6: plug in only the XL330-M288 of elbow_flex (id 3) …" in result.err
    assert result.err.count("Unplug this servo.") == 5
    assert result.err.splitlines()[-1] == (
        "All servos are set up. Connect them to each other, then run: ikservo doctor --arm koch"
    )


def test_servo_plugged_in_too_early_gets_its_own_id(run_cli, monkeypatch):
    operators, _ = with_operator(monkeypatch, "so101", clumsy=True)
    result = run_cli("setup so101 --port sim --yes")
    assert result.code == 0, result.err
    assert [servo.id for servo in operators[0].servos] == [1, 2, 3, 4, 5, 6]


def test_setup_refuses_several_servos_and_writes_nothing(run_cli, monkeypatch):
    ports = change_bus(monkeypatch, lambda line: None)
    result = run_cli("setup so101 --port sim --yes --wait 5")
    assert result.code == 4
    assert "More than one servo answers: STS3215 at id 1, 1000000 baud; " in result.err
    assert "had 6 servos for 5 s; only one at a time can be set up." in result.err
    assert [servo.memory.eeprom_writes for servo in ports[0].line.world.servos] == [
        servo.memory.eeprom_writes for servo in fresh_servos()
    ]


def fresh_servos():
    return servosim.open_port(f"sim:{CONFIGS / 'so101' / 'arm.toml'}").line.world.servos


def all_but(number):
    def change(line):
        for servo in line.world.servos:
            servo.powered = servo.id == number

    return change


def test_setup_refuses_two_servos_with_same_id(run_cli, monkeypatch):
    def change(line):
        all_but(3)(line)
        line.servos[4].powered = True
        line.servos[4].memory.put("id", 3)

    change_bus(monkeypatch, change)
    result = run_cli("setup so101 --port sim --yes --start elbow_flex --wait 5")
    assert result.code == 4
    assert "More than one servo answers: several servos at id 3" in result.err


def test_setup_writes_nothing_to_servo_already_configured(run_cli, monkeypatch):
    ports = change_bus(monkeypatch, all_but(6))
    result = run_cli("setup so101 --port sim --start gripper --yes")
    assert result.out == "✓ gripper (id 6): nothing to change\n"
    assert result.code == 0
    before = fresh_servos()[5].memory.eeprom_writes
    assert ports[0].line.servos[6].memory.eeprom_writes == before


def test_setup_refuses_servo_of_other_model(run_cli, monkeypatch):
    change_bus(monkeypatch, all_but(3))
    result = run_cli("setup koch --port sim --yes")
    assert result.code == 6
    assert "shoulder_pan (id 1) must be a XL430-W250, but a XL330-M288 at id 3" in result.err


def test_setup_without_servo_ends_and_says_how_to_continue(run_cli, monkeypatch):
    change_bus(monkeypatch, all_but(99))
    result = run_cli("setup so101 --port sim --yes --start wrist_flex --wait 3")
    assert result.code == 4
    assert "has no servo within 3 s (all ids, " in result.err
    assert "Continue with: ikservo setup so101 --start wrist_flex" in result.err


def test_setup_without_terminal_names_yes_option(run_cli, monkeypatch):
    def change(line):
        all_but(6)(line)
        line.servos[6].memory.put("id", 9)

    ports = change_bus(monkeypatch, change)
    result = run_cli("setup so101 --port sim --start gripper")
    assert result.code == 2
    assert "Cannot ask: input is not a terminal.\nGive --yes." in result.err
    assert 9 in ports[0].line.servos


def test_setup_writes_arm_file_settings(run_cli, monkeypatch):
    def change(line):
        all_but(9)(line)
        line.servos[9].memory.put("velocity_limit", 265)
        line.servos[9].memory.put("return_delay_time", 0)

    ports = change_bus(monkeypatch, change)
    result = run_cli("setup wx250s --port sim --yes --start gripper")
    assert result.out == "✓ gripper (id 9): velocity_limit 265 → 131\n"
    assert ports[0].line.servos[9].read("velocity_limit") == 131


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("setup", 2, "Missing argument 'ARM'"),
        ("setup so1o1 --port sim", 2, "Did you mean so101?"),
        ("setup so101 --port sim --start elbow", 2, "Did you mean elbow_flex?"),
        ("setup so101 --port sim --wait 0", 2, "Invalid value for '--wait'"),
        ("setup so101 --port sim --wait=-5", 2, "Invalid value for '--wait'"),
        ("setup so101 --port sim --wait inf", 2, "Invalid value for '--wait'"),
        ("setup so101 --port sim --wait nan", 2, "Invalid value for '--wait'"),
        ("setup so101 --port /dev/ttyNONE7", 3, "/dev/ttyNONE7"),
    ],
)
def test_bad_setup_command_gives_one_clear_error(run_cli, words, code, message):
    result = run_cli(words)
    assert result.code == code
    assert message in result.err
    assert result.out == ""


def test_setup_stops_if_finished_servo_stays_plugged_in(run_cli, monkeypatch):
    change_bus(monkeypatch, all_but(5))
    result = run_cli("setup so101 --port sim --start wrist_roll --yes --wait 3")
    assert result.code == 4
    assert result.out == "✓ wrist_roll (id 5): nothing to change\n"
    assert result.err.splitlines()[-3:] == [
        "Continue with: ikservo setup so101 --start gripper",
        f"sim:{CONFIGS / 'so101' / 'arm.toml'} still has a servo with id 5 after 3 s.",
        "Unplug the finished servo.",
    ]


# --- servos at other rates and of other families ---

STS_CODES = {500_000: 1, 250_000: 2, 128_000: 3, 115_200: 4, 76_800: 5, 57_600: 6, 38_400: 7}


def at_rate(code):
    def change(line):
        all_but(6)(line)
        line.servos[6].memory.put("baud_rate", code)

    return change


@pytest.mark.parametrize(
    "rate",
    [r if r == 115_200 else pytest.param(r, marks=pytest.mark.campaign) for r in STS_CODES],
)
def test_setup_finds_servo_at_any_baud_rate(run_cli, monkeypatch, rate):
    ports = change_bus(monkeypatch, at_rate(STS_CODES[rate]))
    result = run_cli("setup so101 --port sim --start gripper --yes")
    assert result.code == 0, result.err
    assert f"Found STS3215 at id 6, {rate} baud" in result.err
    assert result.out == f"✓ gripper (id 6): baud_rate {STS_CODES[rate]} → 0 (1000000 baud)\n"
    assert ports[0].line.servos[6].baud == 1_000_000


def other_arm(monkeypatch, name, change):
    """Put the servos of one arm on the line of any requested arm."""
    opened = servosim.open_port

    def open_port(url):
        port = opened(f"sim:{CONFIGS / name / 'arm.toml'}")
        change(port.line)
        return port

    monkeypatch.setattr("servosim.open_port", open_port)


@pytest.mark.parametrize(("code", "rate"), [(1, 57_600), (2, 115_200)])
def test_setup_reports_servo_of_another_family(run_cli, monkeypatch, code, rate):
    def change(line):
        all_but(3)(line)
        line.servos[3].memory.put("baud_rate", code)

    other_arm(monkeypatch, "koch", change)
    result = run_cli("setup so101 --port sim --yes")
    assert result.code == 6
    assert f"must be a STS3215, but a XL330-M288 at id 3, {rate} baud is" in result.err


def test_setup_reports_intermittent_replies_of_servo(run_cli, monkeypatch):
    change_bus(monkeypatch, all_but(6))
    looks = itertools.count()

    def now_and_then(port, rate, framings):
        found = scan_rate(port, rate, framings)
        return found if found and not next(looks) % 3 else []

    monkeypatch.setattr("ikservo.apps.workbench.id_and_baud_rate.scan_rate", now_and_then)
    result = run_cli("setup so101 --port sim --start gripper --yes --wait 5")
    assert result.code == 4
    assert "has STS3215 at id 6, 1000000 baud, which did not answer reliably" in result.err


def test_setup_prints_that_it_searches_and_how_to_end_it(set_up):
    _, result = set_up["koch"]
    assert "Searching at every baud rate. If you stop" in result.err


@pytest.mark.parametrize("searched", [1, 20, 50, 65, 80, 86])  # rates before it is plugged in
def test_servo_plugged_in_during_search_is_found_within_seconds(searched):
    with open_port(f"sim:{CONFIGS}/so101/arm.toml?hand=box", 1_000_000) as port:
        servo = port.transport.line.world.servos[1]
        search = wait_for_servo(port, control_table("STS3215"), 1_000_000, 300.0)
        for _ in range(searched):
            next(search)
        servo.power_up()
        since_s = port.clock.now_s()
        found = _run_to_end(search)
        assert (found.id, found.baud_rate) == (1, 1_000_000)
        assert port.clock.now_s() - since_s < 6.0


def _run_to_end(search):
    while True:
        try:
            next(search)
        except StopIteration as end:
            return end.value
