"""A student's session in a terminal: planar arms, methods, pictures, wrong input."""

import sys

import pytest

from tests.journeys.terminal import Terminal

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys")

COMPARED = ("bounded", "pseudo_inverse", "transpose", "ccd", "closed_form")


@pytest.fixture(params=[80, pytest.param(120, marks=pytest.mark.campaign)])
def terminal(request, tmp_path):
    return Terminal(request.param, {"IKSERVO_HOME": str(tmp_path / "home")})


def test_solve_compare_lists_methods_on_planar_arm(terminal):
    ended = terminal.run("solve", "0.25", "0.10", "0.05", "--arm", "planar3", "--compare")
    assert ended.code == 0
    assert all(any(line.strip().startswith(name) for line in ended.screen) for name in COMPARED)
    assert not ended.long


def test_solve_all_lists_both_elbows_of_two_links(terminal):
    ended = terminal.run("solve", "0.20", "0.10", "0.05", "--arm", "planar2", "--all")
    assert ended.code == 0
    assert [line.split()[0] for line in ended.screen[1:3]] == ["1", "2"]
    assert not ended.long


def test_solve_command_plots_trace_to_png_file(terminal, tmp_path):
    picture = tmp_path / "ccd.png"
    words = ["solve", "0.25", "0.10", "0.05", "--arm", "planar3", "--method", "ccd"]
    ended = terminal.run(*words, "--trace", "--plot", picture)
    assert ended.code == 0, ended.text
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_solve_of_point_out_of_reach_exits_7(terminal):
    ended = terminal.run("solve", "0.9", "0", "0.05", "--arm", "planar2")
    assert ended.code == 7
    assert not ended.long


def test_solve_help_fits_terminal_width(terminal):
    ended = terminal.run("solve", "--help")
    assert ended.code == 0
    assert not ended.long


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "words",
    [
        "solve 0,25 0 0.1 --arm so101",
        "solve nan 0 0.1 --arm so101",
        "solve 0.2 0 0.1 --arm so102",
        "solve 0.2 0 0.1 --arm so101 --method newton",
        "workspace --arm nowhere",
        "solve 0.2 0 --arm so101",
    ],
)
def test_invalid_solve_arguments_exit_2_with_short_error(terminal, words):
    ended = terminal.run(*words.split())
    assert ended.code == 2
    assert "Traceback" not in ended.text
    assert 1 <= len(ended.screen) <= 8
    assert not ended.long
