"""On a full, read-only or missing disk each failure has a message, and old files stay."""

import ast
import dataclasses
import errno
import io
import os
import resource
import signal
import subprocess
import sys
import typing
from importlib import import_module
from pathlib import Path

import pytest

import ikservo
from ikservo.apps.teaching.recorder import read_recording
from ikservo.cli.command_group import all_commands

SIM = "--arm so101 --port sim"
RECORDING = f"record {{}} --duration 2 {SIM}"
# Options and arguments that name a file which is read.
READ = {
    ("arms new", "source"), ("calibrate", "from_script"), ("calibrate", "points"),
    ("calibrate", "from_pictures"),
    ("calibration adopt", "source"), ("servo restore", "file"), ("servo packets", "file"),
    ("arc", "scene"), ("draw", "scene"), ("joints", "scene"), ("look", "scene"),
    ("scene check", "file"), ("scene show", "file"),
    ("draw", "file"), ("export", "recordings"),
    ("import lerobot", "from_script"), ("import recording", "file"),
    ("import dataset", "folder"), ("replay", "file"),
    ("move", "scene"), ("pose", "scene"), ("setup", "restore"), ("test", "points"),
    ("gripper", "scene"), ("jog", "scene"), ("program check", "scene"), ("program run", "scene"),
    ("program check", "file"), ("program run", "file"), ("replay", "scene"),
    ("serve", "scene"), ("view", "scene"), ("mcp", "scene"), ("mcp", "journal"),
}  # fmt: skip
# Those that name a file or folder which is written: command lines, and the file that is named in
# the error. {} is the folder.
WRITTEN = {
    ("arms new", "folder"): [("arms new two --joint a=z:0.1 --folder {}", "arm.toml")],
    ("calibrate", "save_pictures"): [
        ("calibrate so101 --port sim --camera sim --yes --save-pictures {}/a", "pictures.toml")
    ],
    ("export", "to"): [
        ("export csv {source} --to {}/a.csv", "a.csv"),
        ("export csv {source} --to {}/old.csv", "old.csv"),
        ("export dataset {source} --arm so101 --to {}/a", "file-000.parquet"),
    ],
    ("import dataset", "to"): [
        ("import dataset {dataset} --arm so101 --to {}/a", "data-000.jsonl"),
    ],
    ("net keys", "folder"): [
        ("net keys --folder {}/a", "authority.pem"),
        ("net keys --folder {}/keys --new", "authority.pem"),
    ],
    ("program new", "file"): [("program new {}/a.toml --arm so101", "a.toml")],
    ("record", "file"): [
        (RECORDING.format("{}/a.jsonl"), "a.jsonl"),
        (RECORDING.format("{}/a.mcap"), "a.mcap"),
        (f"{RECORDING.format('{}/old.jsonl')} --overwrite", "old.jsonl"),
        (f"{RECORDING.format('{}/old.mcap')} --overwrite", "old.mcap"),
    ],
    ("servo backup", "to"): [
        ("servo backup --arm so101 --port sim --id 3 --to {}/a.toml", "a.toml"),
        ("servo backup --arm so101 --port sim --id 3 --to {}/old.toml --overwrite", "old.toml"),
    ],
    ("camera", "file"): [
        ("camera board {}/a.pdf", "a.pdf"),
        ("camera board {}/old.svg --overwrite", "old.svg"),
    ],
    ("solve", "plot"): [
        ("solve 0.25 0.05 0.15 --arm so101 --compare --plot {}/a.svg", "a.svg"),
        ("solve 0.25 0.05 0.15 --arm so101 --compare --plot {}/old.svg", "old.svg"),
    ],
    ("test", "html"): [
        (f"test so101 --port sim --cycles 2 --parts poses --yes --no-wiggle --html {{}}/{name}",
         name.split()[0])
        for name in ("a.html", "old.html --overwrite")
    ],
    ("view", "record"): [("view so101 --port sim --no-open --task a --record {}/a", ".probe")],
    ("workspace", "plot"): [("workspace --arm so101 --slice side --plot {}/old.png", "old.png")],
}  # fmt: skip
LINES = [line for lines in WRITTEN.values() for line in lines]
NAMES = [f"{words.split()[0]} {file}" for words, file in LINES]
BYTES = 4096


def file_parameters():
    """Yield the command and name of each option and argument that is a path."""
    for name, each in all_commands().items():
        place, _, function = each.module.partition(":")
        command = getattr(import_module(place), function or "command") if place else None
        for parameter in path_parameters(command) if command else ():
            yield name, parameter


def path_parameters(described):
    """Yield the names of a command's parameters of type Path, groups of options included."""
    for parameter, kind in typing.get_type_hints(described).items():
        if dataclasses.is_dataclass(kind):
            yield from path_parameters(kind)
        elif "Path" in str(kind):
            yield parameter


def test_every_file_option_is_listed_as_read_or_written():
    assert {*file_parameters()} == READ | set(WRITTEN)


# What writes without files/writing.py: folders of sockets, a page in a folder of this process,
# the null device, pictures that are drawn into memory, and lines that are appended to a journal.
WRITERS = {
    "files/writing.py", "serving/control_socket.py", "apps/agent/agent_journal.py",
    "serving/early_stops.py", "apps/page/view_command.py",
    "cli/entry_point.py", "cli/plots.py",
}  # fmt: skip
WRITING_CALLS = {"write_text", "write_bytes", "mkdir", "touch", "savefig", "NamedTemporaryFile"}


@pytest.mark.full
def test_only_listed_source_modules_write_files():
    folder = Path(ikservo.__file__).parent
    found = {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Call) and _writes(node)
    }
    assert found == WRITERS


def _writes(call):
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    modes = {str(each.value)[:1] for each in call.args if isinstance(each, ast.Constant)}
    return name in WRITING_CALLS or (name == "open" and bool(modes & set("wxa")))


def run_limited(words, limit, home):
    """Run a command in a process with a limit of file size, as on a full disk."""

    def set_limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))

    # Without -B truncated bytecode would be left for every later run.
    command = [sys.executable, "-B", "-m", "ikservo", *words.split()]
    return subprocess.run(
        command, capture_output=True, text=True, preexec_fn=set_limit, timeout=100, check=False,
        env=os.environ | {"IKSERVO_HOME": str(home)},
    )  # fmt: skip


@pytest.fixture
def place(tmp_path):
    """Return a folder with an existing file of each kind."""
    folder = tmp_path / "place"
    (folder / "keys" / "authority").mkdir(parents=True)
    for name in ("old.jsonl", "old.mcap", "old.csv", "old.svg", "old.png", "old.html"):
        (folder / name).write_text("the old one")
    (folder / "keys" / "authority" / "authority.pem").write_text("the old one")
    return folder


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """Return a recording and a data set."""
    folder = tmp_path_factory.mktemp("sources")
    recording, data = folder / "source.jsonl", folder / "data"
    run_limited(RECORDING.format(recording), 10**9, folder)
    run_limited(f"export dataset {recording} --arm so101 --to {data}", 10**9, folder)
    return {"source": recording, "dataset": data}


def content(folder):
    """Return the bytes of each file."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def require_sentence(done, file, why, before, place):
    """Check that one message names the failed file, and that no other file changed."""
    text = " ".join(done.err.split())
    assert done.code != 0
    assert text.count("cannot be written") == 1
    assert f"{file} cannot be written: {why}" in text
    after = content(place)
    if "The samples recorded so far are in" not in text:
        assert after == before
    assert before.items() <= after.items()


@pytest.mark.sample(5)
@pytest.mark.full
@pytest.mark.parametrize(("words", "file"), LINES, ids=NAMES)
def test_full_disk_is_reported_and_old_files_stay(words, file, place, sources, tmp_path):
    before = content(place)
    limit = BYTES if words.startswith("record") else 100
    done = run_limited(words.format(place, **sources), limit, tmp_path)
    assert "Traceback" not in done.stderr
    done.code, done.err = done.returncode, done.stderr
    require_sentence(done, file, "File too large", before, place)


@pytest.mark.full
@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOENT], ids=errno.errorcode.get)
@pytest.mark.parametrize(("words", "file"), LINES, ids=NAMES)
def test_read_only_or_missing_disk_gives_clear_error(
    words, file, number, place, sources, run_cli, monkeypatch
):
    before = content(place)
    break_disk(monkeypatch, place, number)
    done = run_cli(words.format(place, **sources))
    monkeypatch.undo()
    named = file if (place / words.split("{}/")[-1].split()[0]).exists() else ""
    require_sentence(done, named, os.strerror(number), before, place)


def break_disk(monkeypatch, folder, number):
    """Let every call that writes below a folder fail."""

    def failing(call, writes):
        def run(path, *args, **kwargs):
            is_open = isinstance(path, int)  # a pipe of a process, for one
            if (
                writes(*args, **kwargs)
                and not is_open
                and Path(os.fsdecode(path)).is_relative_to(folder)
            ):
                raise OSError(number, os.strerror(number), os.fsdecode(path))
            return call(path, *args, **kwargs)

        return run

    monkeypatch.setattr(os, "open", failing(os.open, lambda flags, *_, **__: flags & os.O_ACCMODE))
    monkeypatch.setattr(os, "mkdir", failing(os.mkdir, lambda *_, **__: True))
    monkeypatch.setattr(io, "open", failing(io.open, lambda mode="r", *_, **__: mode[0] != "r"))


@pytest.mark.full
def test_recording_ended_by_full_disk_can_be_read(place, tmp_path):
    done = run_limited(RECORDING.format(place / "a.jsonl"), BYTES, tmp_path)
    assert "The samples recorded so far are in" in done.stderr
    assert len(read_recording(place / "a.jsonl").times_s) > 10


@pytest.mark.full
@pytest.mark.parametrize(("words", "file"), WRITTEN["record", "file"])
def test_recording_without_samples_leaves_no_file(words, file, place, tmp_path):
    before = content(place)
    done = run_limited(words.format(place), 0, tmp_path)
    assert done.returncode == 1
    assert f"{file} cannot be written: File too large" in " ".join(done.stderr.split())
    assert "The samples recorded so far" not in done.stderr
    assert content(place) == before


@pytest.mark.sample(1)
@pytest.mark.parametrize("suffix", [".jsonl", ".mcap"])
def test_overwrite_option_replaces_file_when_recording_ends(suffix, place, run_cli):
    path, before = place / f"old{suffix}", set(content(place))
    assert run_cli(f"{RECORDING.format(path)} --overwrite").code == 0
    assert len(read_recording(path).times_s) > 10
    assert set(content(place)) == before


def test_pose_that_cannot_be_saved_gives_clear_error(run_cli, place, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(place))
    break_disk(monkeypatch, place, errno.ENOSPC)
    done = run_cli(f"teach cup --now {SIM}")
    assert done.code == 1
    assert "cannot be written: No space left on device" in done.err


PRINTERS = [
    "arms", "solve 0.25 0.05 0.15 --arm so101", f"where {SIM}", f"pose home {SIM} --yes",
    "workspace --arm so101",
]  # fmt: skip


@pytest.mark.full
@pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full")
@pytest.mark.parametrize("words", PRINTERS)
def test_stdout_redirected_to_full_disk_exits_with_1(words):
    command = [sys.executable, "-m", "ikservo", *words.split()]
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=100, check=False
        )
    assert done.returncode == 1
    assert "could not be written" in done.stderr
