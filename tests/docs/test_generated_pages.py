"""The generated pages contain everything in their sources."""

import re
from pathlib import Path

import pytest

import ikservo
from ikservo import errors
from ikservo.cli import main
from ikservo.cli.command_group import all_commands, load_command
from ikservo.errors import ExitCode, IkservoError
from ikservo.model.arm_schema import ArmFile
from ikservo.registers.models import MODELS
from tests.docs.pages_tool import GENERATED, WIRINGS, draw, generated_pages

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def pages():
    return generated_pages()


def section(page, heading, level):
    """Return the text below a heading, up to the next one of its level or above."""
    marks = "#" * level
    found = re.search(
        rf"^{marks} {re.escape(heading)}\n(.*?)(?=^#{{1,{level}}} |\Z)", page, re.S | re.M
    )
    assert found, heading
    return found[1]


def test_every_generated_page_is_in_the_navigation():
    navigation = (ROOT / "mkdocs.yml").read_text()
    assert [path for path in GENERATED if f": {path}\n" not in navigation] == []


@pytest.mark.parametrize("name", [n for n, each in all_commands().items() if each.module])
def test_command_page_lists_every_option(pages, name):
    text = section(pages["reference/commands.md"], f"ikservo {name}", 3)
    command = load_command(name, all_commands()[name])
    options = [each for param in command.params for each in param.opts if each.startswith("--")]
    assert [each for each in options if each not in text] == []


def test_arm_file_page_has_type_and_default_of_every_key(pages):
    text = pages["reference/arm-toml.md"]
    assert [key for key in ArmFile.model_fields if f"| `{key}` |" not in text] == []
    assert "| `gear` | number, above 0 | no; default `1.0` |" in text
    assert "| `id` | whole number, at least 0, at most 252 | yes |" in text


def test_shipped_arm_files_use_only_documented_keys(pages):
    text = pages["reference/arm-toml.md"]
    listed = set(re.findall(r"^\| `(\w+)` \|", text, re.M))
    nested = re.compile(r"^(\w+) *=", re.M)
    for path in (ROOT / "configs").glob("*/arm.toml"):
        top = path.read_text("utf-8").partition("[")[0]
        assert set(nested.findall(top)) <= listed, path


@pytest.mark.parametrize("model", MODELS.values(), ids=list(MODELS))
def test_register_page_lists_every_register_with_address(pages, model):
    text = section(pages["reference/registers.md"], model.model_name, 2)
    rows = set(re.findall(r"^\| (\d+) \| (\d) \| `(\w+)`", text, re.M))
    assert rows == {
        (str(each.address), str(each.size), name) for name, each in model.registers.items()
    }


def test_page_protocol_describes_every_message_sent(pages):
    sent = set()
    for path in (ROOT / "ikservo/apps/page/static").glob("*.js"):
        if ".min." not in path.name:
            sent |= set(re.findall(r'\bsend\("(\w+)"', path.read_text("utf-8")))
    described = set(re.findall(r"^### (\w+)$", pages["reference/page-protocol.md"], re.M))
    assert sent <= described
    assert len(sent) > 10


def test_error_page_contains_message_printed_by_a_command(pages, capsys):
    main(["gripper", "open", "--arm", "planar2", "--port", "sim"])
    printed = capsys.readouterr().err.splitlines()[-2]
    rows = section(pages["reference/error-messages.md"], "Exit code 1: failed", 2)
    messages = [row.split(" | ")[0].removeprefix("| ") for row in rows.splitlines()[3:]]
    assert any(re.fullmatch(re.escape(each).replace("…", ".*"), printed) for each in messages)


TROUBLE = (ROOT / "docs/troubleshooting.md").read_text("utf-8")


@pytest.mark.parametrize("exit_code", ExitCode, ids=str)
def test_troubleshooting_page_lists_every_error_by_exit_code(exit_code):
    text = section(TROUBLE, f"Exit code {exit_code.value}: {exit_code.meaning}", 3)
    kinds = [each for each in vars(errors).values() if is_error(each)]
    names = {each.__name__ for each in kinds if each.exit_code is exit_code}
    assert {name for name in names if f"`{name}`" not in text} == set()


def is_error(value):
    return isinstance(value, type) and issubclass(value, IkservoError)


def test_python_reference_contains_every_public_name():
    text = (ROOT / "docs/reference/python.md").read_text("utf-8")
    assert [name for name in ikservo.__all__ if f"::: ikservo.{name}\n" not in text] == []


def test_lecture_page_contains_every_section_cited_in_code():
    page = (ROOT / "docs/lecture.md").read_text("utf-8")
    explained = set(re.findall(r"^### (L\d+)\. .* \{#l\d+\}$", page, re.M))
    sources = [*(ROOT / "ikservo").rglob("*.py"), *(ROOT / "tests").rglob("*.py")]
    texts = [path.read_text("utf-8") for path in sources]
    cited = {each for text in texts for each in re.findall(r"lecture (L\d+)|\((L\d+)[,)]", text)}
    assert explained == {f"L{number}" for number in range(1, 20)}
    assert {one or other for one, other in cited} <= explained


def test_files_named_by_the_lecture_page_exist():
    page = (ROOT / "docs/lecture.md").read_text("utf-8")
    named = set(re.findall(r"`(ikservo/[\w/]+\.py)`", page))
    assert [path for path in named if not (ROOT / path).exists()] == []
    assert len(named) > 5


@pytest.mark.parametrize("wiring", WIRINGS, ids=lambda each: each.arm)
def test_wiring_drawings_show_the_servo_ids_of_arm_files(wiring):
    stored = (ROOT / f"docs/pictures/wiring-{wiring.arm}.svg").read_text("utf-8")
    assert stored == draw(wiring)
    for joint in ikservo.load_model(wiring.arm).joints:
        assert f">id {joint.servo.id}<" in stored
