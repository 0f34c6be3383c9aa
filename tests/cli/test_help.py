"""The first screen shows the commands and exit codes and imports nothing for it."""

import subprocess
import sys

import pytest

import ikservo
from ikservo.cli.command_group import all_commands
from ikservo.core_commands import PANELS
from ikservo.errors import ExitCode


def test_help_lists_every_command(run_cli):
    out = run_cli("--help").out
    assert all(word in out for word in all_commands() if " " not in word)


def test_help_lists_every_exit_code(run_cli):
    out = " ".join(run_cli("--help").out.split())
    assert all(f"{code.value} {code.meaning}" in out for code in ExitCode)


@pytest.mark.parametrize("word", sorted(set(all_commands()) - {"sim"}))
def test_every_command_has_help(run_cli, word):
    result = run_cli(f"{word} --help")
    assert result.code == 0
    assert f"ikservo {word}" in result.out


def test_sim_command_has_help_and_refuses_unknown_options(run_cli):
    assert run_cli("sim --help").code == 0
    assert run_cli("sim --servo 1:sts3215 --no-such").code == ExitCode.USAGE


def test_command_without_arguments_prints_help_and_exits_2(run_cli):
    result = run_cli("")
    assert "Set up" in result.out + result.err
    assert result.code == 2


def test_unknown_command_gives_usage_error(run_cli):
    result = run_cli("mvoe 1 2 3")
    assert result.code == 2
    assert "mvoe" in result.err


HEAVY = ("numpy", "scipy", "pydantic", "ruckig", "serial", "dynamixel_sdk", "scservo_sdk",
         "servosim", "ikservo.model", "ikservo.hardware")  # fmt: skip


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("words", "allowed"),
    [
        ("--help", ()),
        ("arms", ("numpy", "pydantic", "ikservo.model")),
        ("solve 0.25 0.05 0.15 --arm so101", ("numpy", "pydantic", "ikservo.model")),
        (
            "ports",
            ("serial", "pydantic", "ikservo.hardware"),
        ),  # typer itself takes pydantic where it runs a command
        ("scan --port /dev/ttyNONE7", ("serial", "pydantic", "ikservo.hardware")),
    ],
)
def test_command_imports_only_modules_it_uses(words, allowed):
    script = (
        "import sys; from ikservo.cli import main; code = main(sys.argv[2:]);"
        "print([m for m in sys.argv[1].split(',') if m in sys.modules], file=sys.stderr)"
    )
    forbidden = ",".join(set(HEAVY) - set(allowed))
    done = subprocess.run([sys.executable, "-c", script, forbidden, *words.split()],
                          capture_output=True, text=True, check=True)  # fmt: skip
    assert done.stderr.strip().splitlines()[-1] == "[]"


@pytest.mark.parametrize("word", ["", *sorted(set(all_commands()) - {"sim"})])
def test_short_help_option_prints_help_of_every_command(run_cli, word):
    result = run_cli(f"{word} -h")
    assert (result.code, "Usage: ikservo" in result.out) == (0, True)


def test_version_option_prints_the_version(run_cli):
    result = run_cli("--version")
    assert (result.code, result.out) == (0, f"{ikservo.__version__}\n")


def test_python_m_ikservo_runs_command_line():
    done = subprocess.run([sys.executable, "-m", "ikservo", "--version"],
                          capture_output=True, text=True, check=True)  # fmt: skip
    assert done.stdout == f"{ikservo.__version__}\n"


def test_package_contains_py_typed():
    from pathlib import Path

    assert (Path(ikservo.__file__).parent / "py.typed").exists()


def test_help_lists_commands_in_groups(run_cli):
    out = run_cli("--help").out
    places = [out.index(f" {panel} ") for panel in PANELS]
    assert places == sorted(places)
    for panel, after in zip(PANELS, [*list(PANELS)[1:], None], strict=True):
        part = out[out.index(f" {panel} ") : out.index(f" {after} ") if after else None]
        words = [name for name, each in all_commands().items() if each.panel == panel]
        assert all(f" {word} " in part for word in words if " " not in word)


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("move --arm so1", "so100 so101"),
        ("pose --arm so101 ho", "home"),
        ("joints --arm so101 elb", "elbow_flex="),
        ("jog --arm so101 shoulder_p", "shoulder_pan"),
        ("move --speed fa", "fast"),
        ("solve --method cl", "closed_form"),
        ("gripper cl", "close"),
        ("calibration s", "show"),
        ("calibration re", "restore resume revert"),
        ("program ch", "check"),
        ("import data", "dataset"),
        ("export l", "lerobot"),
        ("net ac", "acknowledge"),
        ("rec", "record recover"),
    ],
)
def test_shell_completion_completes_arms_poses_and_options(run_cli, monkeypatch, typed, offered):
    monkeypatch.setenv("_IKSERVO_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"ikservo {typed}")
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split())))
    result = run_cli("")
    assert (result.code, result.out.split(), result.err) == (0, offered.split(), "")
