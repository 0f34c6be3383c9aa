"""``ikservo program``: a first program, checks that name the step, runs and their ends."""

import pytest

SIM = "--port sim:?pose=home"


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "tea.toml"
    path.write_text(
        'format = 1\narm = "so101"\n[[steps]]\ntip_m = [0.22, 0.04, 0.12]\n'
        '[[steps]]\nname = "down"\ntip_m = [0.22, 0.04, 0.10]\npath = "line"\n'
    )
    return path


@pytest.mark.parametrize("arm", ["so101", "koch", "px100", "planar3", "vx300s"])
def test_new_program_of_each_arm_passes_check(run_cli, tmp_path, arm):
    path = tmp_path / "first.toml"
    assert run_cli(f"program new {path} --arm {arm}").code == 0
    result = run_cli(f"program check {path} --port sim")
    assert result.code == 0, result.err


def test_program_new_keeps_existing_file_without_overwrite(run_cli, file):
    before = file.read_text()
    result = run_cli(f"program new {file} --arm so101")
    assert (result.code, file.read_text()) == (1, before)
    assert "--overwrite" in result.err
    assert run_cli(f"program new {file} --arm so101 --overwrite").code == 0


@pytest.mark.campaign
def test_program_run_prints_each_step_and_the_step_count(run_cli, file):
    result = run_cli(f"program run {file} {SIM} --yes")
    assert result.code == 0
    assert "2/2  down: line to (0.220, 0.040, 0.100) m" in result.err
    assert result.out.split() == ["steps", "2", "done"]


@pytest.mark.full
def test_program_run_json_has_error_of_each_step(run_cli, file):
    result = run_cli(f"program run {file} {SIM} --yes --json")
    assert result.json["schema"] == "ikservo/program-run/1"
    assert [step["number"] for step in result.json["steps"]] == [1, 2]
    assert all(step["error_m"] < 0.003 for step in result.json["steps"])


def test_program_check_names_impossible_steps_and_exits_with_7(run_cli, file):
    far = '[[steps]]\nname = "far"\ntip_m = [0.9, 0.0, 0.1]\n'
    file.write_text(f"{file.read_text()}{far}{far}")
    for action in ("check", "run --yes"):
        result = run_cli(f"program {action} {file} {SIM}")
        assert result.code == 7
        for place in ("3/4", "4/4"):
            text = f"{place}  far: joints to (0.900, 0.000, 0.100) m: cannot be carried out"
            assert text in result.err
        assert "Steps 3, 4 of 4 cannot be carried out; nothing moved." in result.err
        assert "1/4  " not in result.err.split("cannot be carried out")[1]


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("program walk {file}", 2),
        ("program check {file}.missing", 2),
        ("program check {file} --from 3", 2),
        ("program check {file} --arm koch", 2),
        ("program run {file} --yes --step", 2),
    ],
)
def test_bad_program_command_gives_one_clear_error(run_cli, file, line, code):
    result = run_cli(f"{line.format(file=file)} {SIM}")
    assert result.code == code
    assert result.out == ""


MISTAKES = {
    'gripper = "shut"': 'step 2, gripper: is "shut"; expected open, close, or a width in metres',
    'pos = "home"': "step 2, pos: is not a known key; expected pose",
    "tip_m = [0.2, 0.0]": "step 2, tip_m[2]: is missing; expected [x, y, z] in metres",
    'pose = "home"\nwait_s = 1': "step 2: needs one action, but has pose and wait_s",
    "wait_s = 1\ngrid = { rows = 31, columns = 1 }": "step 2, grid.rows: is 31; "
    "expected rows and columns from 1 to 30",
    'only_if = "seen"\nwait_s = 1': 'step 2, only_if: is "seen"; expected grasped or not grasped',
    'speed = "quick"\nwait_s = 1': 'step 2, speed: is "quick"; expected slow, normal or fast',
}


def test_pause_without_a_terminal_is_refused_before_motion(run_cli, tmp_path):
    path = write_steps(tmp_path / "a.toml", 'pause = "Put in the next part."')
    result = run_cli(f"program run {path} {SIM} --yes")
    assert (result.code, result.out) == (2, "")
    assert "A pause waits for Enter, but input is not a terminal." in result.err


def write_steps(path, *steps):
    text = "\n".join(f"[[steps]]\n{step}" for step in ('pose = "home"', *steps))
    path.write_text(f'format = 1\narm = "so101"\n{text}\n')
    return path


@pytest.mark.parametrize("step", MISTAKES)
def test_program_file_error_states_step_number(step, run_cli, tmp_path):
    path = write_steps(tmp_path / "a.toml", step)
    lines = run_cli(f"program check {path} --port sim").err.split(f"{path}, ")
    assert " ".join(lines[1].split()).startswith(MISTAKES[step])
    assert lines[1].count("step ") == 1


def test_program_errors_do_not_contain_pydantic_messages(run_cli, tmp_path):
    path = write_steps(tmp_path / "a.toml", *MISTAKES)
    err = run_cli(f"program check {path} --port sim").err
    assert all(f"step {number}" in err for number in range(2, 9))
    assert not any(word in err for word in ("literal", "float", "more to correct", "steps["))


def test_program_check_names_all_impossible_steps_at_once(run_cli, tmp_path):
    steps = ("tip_m = [2.0, 0.0, 0.1]", 'pose = "nowhere"', 'recording = "none.jsonl"')
    path = write_steps(tmp_path / "a.toml", *steps, 'pose = "home"')
    result = run_cli(f"program check {path} --port sim")
    assert result.err.count("cannot be carried out") == 4
    assert "Steps 2, 3, 4 of 5 cannot be carried out" in result.err
    assert "ikservo move" not in result.err
