"""Every code block of README and docs runs, or says why it cannot."""

import io
import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest
import typer

from ikservo.cli import main
from ikservo.cli.command_group import all_commands, app
from tests.docs.blocks import PAGES, ROOT, blocks

BLOCKS = [block for page in PAGES for block in blocks(page)]
NUMBER = r"-?\d+(?:\.\d+)?"
LANGUAGES = ("console", "sh", "python", "toml", "json", "text")
COMMAND = re.compile(r"(?:\$ )?ikservo [a-z]+ ?")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Work in an empty folder without a calibration, port or arm of the user."""
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    for name in ("IKSERVO_ARM", "IKSERVO_PORT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def pattern(lines):
    """Return a pattern for shown output: numbers may differ, `…` matches anything."""
    tokens = re.split(rf"({NUMBER}|…|\s+)", lines.strip())
    return "".join(map(_token_pattern, filter(None, tokens)))


def _token_pattern(token):
    if re.fullmatch(NUMBER, token):
        return NUMBER
    if token == "…":
        return ".*"
    return r"\s+" if token.isspace() else re.escape(token)


def split(words):
    """Return program, arguments, and the file after ``>``."""
    program, *args = shlex.split(words, comments=True)
    *before, file = args if ">" in args else (*args, "")
    return program, [word for word in before if word != ">"], file


def run_commands(block, monkeypatch):
    """Run the commands of a block in this process."""
    for words, printed in block.commands:
        out = io.StringIO()
        monkeypatch.setattr("sys.stdout", out)
        monkeypatch.setattr("sys.stderr", out)
        program, args, file = split(words)
        assert program == "ikservo", f"{block}: only ikservo can run here, not {words!r}"
        assert main(args) == block.exit_code, f"{block}: {words}\n{out.getvalue()}"
        if file:
            Path(file).write_text(out.getvalue(), "utf-8")
        elif printed is not None:
            assert re.fullmatch(pattern(printed), out.getvalue().strip()), (
                f"{block}: {words} prints\n{out.getvalue()}"
            )


def run_python(block, names):
    """Run a snippet; a traceback shows the page and its line."""
    text = block.text.replace("/path/to/configs", str(ROOT / "configs"))
    if not block.reason:
        exec(compile("\n" * block.line + text, block.page, "exec"), names)


def read_data(block):
    """Parse a block of data."""
    {"toml": tomllib.loads, "json": json.loads}[block.language](block.text)


PAGES_WITH_CODE = sorted({block.page for block in BLOCKS if block.language != "text"})


@pytest.mark.timeout(600)  # the longest page is many motions, seconds of a core each
@pytest.mark.parametrize("page", PAGES_WITH_CODE)
def test_documentation_code_blocks_run_in_order(page, folder, monkeypatch):
    names = {}
    for block in blocks(ROOT / page):
        if block.language == "python":
            run_python(block, names)
        elif block.language in ("toml", "json"):
            read_data(block)
        elif not block.reason:
            run_commands(block, monkeypatch)


NOTEBOOKS = sorted((ROOT / "docs").rglob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_documentation_notebook_cells_run_in_order(path, folder, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    cells, names = json.loads(path.read_text("utf-8"))["cells"], {}
    for number, cell in enumerate(cells):
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [], "stored without outputs"
            exec(compile("".join(cell["source"]), f"{path.name}, cell {number}", "exec"), names)


def test_documentation_code_blocks_have_language():
    for block in BLOCKS:
        assert block.language in LANGUAGES, f"{block}: {block.language!r}"
        hidden = [line for line in block.text.splitlines() if COMMAND.match(line)]
        assert block.language in ("console", "sh") or not hidden, f"{block}: commands in a text"


def require_command(block, words):
    """Parse a command line without running the command."""
    length = 2 if " ".join(words[:2]) in all_commands() else 1  # such as "arms new"
    name, args = " ".join(words[:length]), words[length:]
    assert name in all_commands(), f"{block}: {name}"
    command = typer.main.get_command(app).get_command(None, name)
    try:
        command.make_context(name, args)
    except Exception as error:
        pytest.fail(f"{block}: {words}: {error}")


def test_unrunnable_documented_commands_have_valid_options():
    for block in BLOCKS:
        for words, _ in block.commands if block.reason else ():
            program, args, _ = split(words)
            if program == "ikservo" and args != ["--install-completion"]:
                require_command(block, args)


def test_documentation_links_lead_to_existing_files():
    missing = [
        f"{page.relative_to(ROOT)}: {link}"
        for page in PAGES
        for link in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text("utf-8"))
        if "://" not in link and not (page.parent / link).exists()
    ]
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_modules_and_tests_named_in_documentation_exist(page):
    folders = ("ikservo", "sim", "tests", "tools", "examples", "integrations", "docs")
    files = [file.as_posix() for each in folders for file in (ROOT / each).rglob("*.py")]
    named = re.findall(r"`([\w./-]+\.py)`", page.read_text("utf-8"))
    made_here = re.findall(r"Save this as `(\w+\.py)`", page.read_text("utf-8"))
    gone = {name for name in named if not any(file.endswith(f"/{name}") for file in files)}
    assert gone == set(made_here)
