"""The page's dialogue for a new arm asks the questions of the command, and requires answers."""

import time

import pytest

from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.panels.dialogue_panel import AnswerDialogue, DialoguePanel, StartNewArm
from ikservo.apps.page.panels.dialogue_process import CheckServos, SetUpServos
from ikservo.model import load_model
from tests.apps.importing.hidden_arm import hide_arm
from tests.apps.importing.test_hostile import CHAIN, LINKS, robot
from tests.oracle import CONFIGS


@pytest.fixture
def panel(tmp_path):
    panel = DialoguePanel(tmp_path)
    yield panel
    panel.close()


def start(panel, name="mine", source="", port=""):
    message = StartNewArm(
        kind="new_arm", seq=1, seen=0, name=name, source=str(source), port=str(port)
    )
    panel.start_new_arm(message)


def answer(panel, text, number=None):
    number = number or panel.fields()["number"]
    panel.answer(AnswerDialogue(kind="answer_dialogue", seq=1, seen=0, number=number, answer=text))


def wait_for(panel, is_there, within_s=120.0):
    written, until_s = (), time.monotonic() + within_s
    while time.monotonic() < until_s:
        written = written or panel.read()
        if is_there(panel.fields()):
            return written
        time.sleep(0.02)
    pytest.fail(f"still {panel.fields()}")


def asked(text):
    return lambda fields: text in (fields["question"] or {"text": ""})["text"]


def ended(fields):
    return bool(fields["error"] or fields["result"])


def test_new_arm_is_written_only_after_consent(panel, tmp_path):
    start(panel)
    wait_for(panel, asked("How many joints"))
    with pytest.raises(BadMessageError):
        answer(panel, "thirteen")
    with pytest.raises(BadMessageError):
        start(panel)
    answer(panel, "2")
    for text in ("z", "0.1", "y", "a yard", "0.12"):
        wait_for(panel, lambda fields: fields["question"])
        answer(panel, text)
    wait_for(panel, asked("Write"))
    answer(panel, "accept", number=1)  # to a question that is no longer asked
    assert not list(tmp_path.iterdir())
    answer(panel, "accept")
    assert wait_for(panel, ended) == (tmp_path / "mine",)
    assert load_model(tmp_path / "mine").chain.dof == 2


def test_xacro_on_page_runs_only_with_consent(panel, tmp_path):
    source, proof = tmp_path / "arm.xacro", tmp_path / "proof"
    source.write_text(robot(LINKS.replace("'a'", f"\"${{open('{proof}', 'w')}}\""), CHAIN))
    start(panel, source=source)
    wait_for(panel, asked("Run them?"))
    answer(panel, "no")
    wait_for(panel, ended)
    assert "xacro" in panel.fields()["error"]
    assert not proof.exists()


@pytest.mark.parametrize("source", ["/dev/zero", "nothing.urdf", ".."])
def test_invalid_arm_description_on_page_gives_one_sentence(panel, source):
    start(panel, source=source)
    wait_for(panel, ended)
    assert panel.fields()["error"].endswith(".")


@pytest.mark.full
def test_cancelled_new_arm_dialogue_writes_nothing(panel, tmp_path):
    start(panel, source=CONFIGS / "so101" / "arm.urdf")
    wait_for(panel, asked("tip"))
    panel.close()
    assert panel.fields() is None
    assert not list(tmp_path.iterdir())


@pytest.mark.full
def test_stop_ends_servo_search_and_does_not_write_arm(panel, tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    port = f"sim:{hide_arm(tmp_path / 'hidden')}?pose=home"
    start(panel, source=CONFIGS / "so101" / "arm.urdf", port=port)
    wait_for(panel, asked("Which link is the tip?"))
    answer(panel, "")
    wait_for(panel, asked("Move it?"))
    assert panel.fields()["moves_servos"]
    process = panel._process
    answer(panel, "accept")
    wait_for(panel, lambda fields: "moving servo" in fields["progress"])
    panel.stop_servos()
    assert "Stopped" in panel.fields()["error"]
    assert not panel.is_running
    until_s = time.monotonic() + 30.0
    while process.exitcode is None and time.monotonic() < until_s:
        time.sleep(0.02)  # the panel waits for the process, and only one can
    assert process.exitcode == 0  # by itself, after it has switched off the torque
    assert not (tmp_path / "mine").exists()


def test_page_on_other_machine_cannot_import_server_files(tmp_path):
    panel = DialoguePanel(tmp_path, is_local=False)
    with pytest.raises(BadMessageError, match="another machine"):
        start(panel, source="/etc/passwd")
    assert not panel.is_running


def test_arm_check_on_page_reports_no_faults_of_healthy_arm(panel):
    panel.start(CheckServos(CONFIGS / "so101" / "arm.toml", "sim"))
    wait_for(panel, ended)
    assert panel.fields()["result"] == "No faults found."
    assert any("all 6 answer at 1000000 baud" in line for line in panel.fields()["lines"])


def test_servo_search_on_page_names_arms_that_match(panel):
    panel.start(CheckServos(CONFIGS / "so101" / "arm.toml", "sim", any_servos=True))
    wait_for(panel, ended)
    assert "✓ arm: these are the servos of so100, so101." in panel.fields()["lines"]


def test_arm_check_on_page_names_silent_servo_and_remedy(panel, tmp_path):
    faults = tmp_path / "faults.toml"
    faults.write_text('[[fault]]\nkind = "silent"\nid = 3\n')
    panel.start(CheckServos(CONFIGS / "so101" / "arm.toml", f"sim:?faults={faults}"))
    wait_for(panel, ended)
    assert panel.fields()["result"].startswith("Faults: 1, ")
    assert any("no answer from elbow_flex (id 3)" in line for line in panel.fields()["lines"])


@pytest.mark.full
def test_servo_setup_on_page_assigns_ids_from_any_servo(panel):
    panel.start(SetUpServos(CONFIGS / "so101" / "arm.toml", "sim"))
    wait_for(panel, asked("Begin with the servo of"))
    assert panel.fields()["question"]["choices"][0] == "shoulder_pan"
    answer(panel, "")
    wait_for(panel, asked("Set it to id 1 at 1000000 baud for shoulder_pan?"))
    answer(panel, "accept")
    wait_for(panel, asked("Set it to id 2 at 1000000 baud for shoulder_lift?"))
    lines = panel.fields()["lines"]
    assert "✓ shoulder_pan (id 1): id 9 → 1" in lines
    assert "Unplug this servo." in lines
    answer(panel, "no")
    wait_for(panel, ended)
    assert panel.fields()["error"].startswith("Cancelled; this servo was not changed.")


def test_second_page_dialogue_is_refused_while_first_runs(panel):
    panel.start(SetUpServos(CONFIGS / "so101" / "arm.toml", "sim"))
    with pytest.raises(BadMessageError, match="Another dialogue is running"):
        panel.start(CheckServos(CONFIGS / "so101" / "arm.toml", "sim"))


def test_page_task_waits_until_left_task_has_closed_its_port(panel):
    task = SetUpServos(CONFIGS / "so101/arm.toml", "sim")
    panel.start(task)
    wait_for(panel, asked("Begin with the servo of"))
    answer(panel, "gripper")
    panel.close()
    with pytest.raises(BadMessageError, match="being ended"):
        panel.start(task)
    until_s = time.monotonic() + 60.0
    while time.monotonic() < until_s:
        try:
            panel.start(task)
        except BadMessageError:
            time.sleep(0.1)
        else:
            return
    pytest.fail("the left task does not end")
