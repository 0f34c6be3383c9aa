"""``ikservo bench bus``: the speed of the bus beside the wire's limit; nothing moves."""

import pytest

from tests.cli.fixtures_ports import change_bus, run_command

# fmt: off
WIRE_BYTES = {  # question, six answers, goals: the protocol's arithmetic
    "so101": (8 + 6 + 6 * 8) + (8 + 6 * 3),
    "koch":  (14 + 6 + 8 + 6 * 8) + (14 + 6 * 5),
}
# fmt: on


@pytest.fixture(scope="module")
def rows():
    arms = ("so101", "koch")
    result = {
        arm: run_command(f"bench bus --arm {arm} --port sim --count 100 --json") for arm in arms
    }
    return {arm: result[arm].json for arm in arms}


@pytest.mark.full
@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_bench_bytes_per_cycle_match_protocol(rows, arm):
    positions = rows[arm]["rows"][0]
    assert positions["sent_bytes"] + positions["received_bytes"] == WIRE_BYTES[arm]


@pytest.mark.full
def test_bench_bus_limit_follows_from_bytes_and_baud_rate(rows):
    positions = rows["so101"]["rows"][0]
    assert positions["wire_limit_per_s"] == pytest.approx(1e6 / 10 / WIRE_BYTES["so101"])


def test_bench_bus_limit_includes_return_delay(rows):
    positions = rows["koch"]["rows"][0]  # one packet, for fast sync read; 500 µs
    wire_s = WIRE_BYTES["koch"] * 10 / 1e6 + 500e-6
    assert positions["wire_limit_per_s"] == pytest.approx(1 / wire_s)


@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_bench_reaches_50_to_100_percent_of_bus_limit(rows, arm):
    for row in rows[arm]["rows"]:
        assert 0.5 < row["cycles_per_s"] / row["wire_limit_per_s"] <= 1.0
        assert row["p50_s"] <= row["p99_s"] <= row["p999_s"]
        assert row["lost"] == 0


def test_bench_json_has_arm_and_baud_rate(rows):
    answer = rows["so101"]
    assert answer["schema"] == "ikservo/bench/1"
    assert (answer["arm"], answer["baud_rate"]) == ("so101", 1_000_000)
    assert [row["what"] for row in answer["rows"]] == [
        "positions + goals", "full telemetry + goals",
    ]  # fmt: skip


def test_bench_table_has_line_for_each_kind_of_cycle(run_cli):
    result = run_cli("bench bus --arm so101 --port sim --count 20")
    assert result.err == "6 servos (STS3215) at 1000000 baud\n"
    assert result.out.split("\n")[0].split() == [
        "each", "cycle", "cycles/s", "wire", "limit/s", "of", "limit", "p50", "ms", "p99", "ms",
        "p99.9", "ms", "host", "ms", "bytes", "lost",
    ]  # fmt: skip
    assert [line.partition("  ")[0] for line in result.out.splitlines()[1:]] == [
        "positions + goals", "full telemetry + goals",
    ]  # fmt: skip


@pytest.mark.parametrize("torque", [0, 1])
def test_bench_command_moves_nothing_and_keeps_torque(run_cli, monkeypatch, torque):
    def change(line):
        for servo in line.world.servos:
            servo.write("torque_enable", torque)

    ports = change_bus(monkeypatch, change)
    assert run_cli("bench bus --arm so101 --port sim --count 50").code == 0
    servos = ports[0].line.world.servos
    assert [servo.read("torque_enable") for servo in servos] == [torque] * 6
    if torque:
        assert max(abs(s.read("goal_position") - s.read("present_position")) for s in servos) < 64


def test_bench_names_silent_servos(run_cli, monkeypatch):
    def change(line):
        for number in (5, 6):
            line.servos[number].powered = False

    change_bus(monkeypatch, change)
    result = run_cli("bench bus --arm so101 --port sim --count 20")
    assert result.code == 4
    assert "wrist_roll (id 5), gripper (id 6)" in result.err


def test_bench_names_id_that_two_servos_share(run_cli, monkeypatch):
    def change(line):
        line.servos[6].memory.put("id", 5)

    change_bus(monkeypatch, change)
    result = run_cli("bench bus --arm so101 --port sim --count 20")
    assert result.code == 4
    assert "wrist_roll (id 5)" in result.err


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("bench", 2, "Missing argument"),
        ("bench coffee --arm so101 --port sim", 2, "'coffee' is not"),
        ("bench bus --port sim", 2, "No arm given."),
        ("bench bus --arm so101 --port sim --count 0", 2, "Invalid value for '--count'"),
        ("bench bus --arm so101 --port /dev/ttyNONE7", 3, "/dev/ttyNONE7"),
    ],
)
def test_bad_bench_command_gives_one_clear_error(run_cli, words, code, message):
    result = run_cli(words)
    assert result.code == code
    assert message in result.err
    assert result.out == ""
