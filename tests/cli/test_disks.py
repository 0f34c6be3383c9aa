"""On a disk that is full, read-only or gone each failure has a sentence, and old files stay."""

import resource
import signal
import subprocess
import sys

import pytest

from ikservo.arm.recorder import read_recording

SIM = "--arm so101 --port sim"
RECORDING = f"record {{}} --duration 2 {SIM}"
# What writes a file at a place that is chosen by its user, with as much as does not fit.
WRITERS = {
    "record": (RECORDING, "a.jsonl"),
    "record an mcap": (RECORDING, "a.mcap"),
    "record over another": (f"{RECORDING} --overwrite", "old.jsonl"),
    "record an mcap over another": (f"{RECORDING} --overwrite", "old.mcap"),
    "export": ("export csv SOURCE --to {}", "a.csv"),
    "program new": ("program new {} --arm so101", "a.toml"),
}
BYTES = 4096


def run_limited(words, limit):
    """Run a command in a process whose files have a largest size, as on a full disk."""

    def set_limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    # Without -B truncated bytecode would be left for every later run.
    command = [sys.executable, "-B", "-m", "ikservo", *words.split()]
    return subprocess.run(
        command, capture_output=True, text=True, preexec_fn=set_limit, timeout=100, check=False
    )


@pytest.fixture
def place(tmp_path):
    for name in ("old.jsonl", "old.mcap"):
        (tmp_path / name).write_text("the old one")
    return tmp_path


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    path = tmp_path_factory.mktemp("source") / "source.jsonl"
    run_limited(RECORDING.format(path), 10**9)
    return path


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_said_by(name, place, source):
    words, file = WRITERS[name]
    limit = 100 if "program" in name else BYTES
    done = run_limited(words.format(place / file).replace("SOURCE", str(source)), limit)
    assert done.returncode != 0
    assert f"{file} cannot be written: File too large" in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("name", ["record over another", "record an mcap over another"])
def test_a_full_disk_leaves_the_old_recording_to(name, place, source):
    words, file = WRITERS[name]
    run_limited(words.format(place / file), BYTES)
    assert (place / file).read_text() == "the old one"


def test_what_was_recorded_until_the_disk_was_full_is_read(place):
    done = run_limited(RECORDING.format(place / "a.jsonl"), BYTES)
    assert "What was recorded until then is in" in done.stderr
    assert len(read_recording(place / "a.jsonl").times_s) > 10


@pytest.mark.parametrize("suffix", [".jsonl", ".mcap"])
def test_a_recording_over_another_replaces_it_at_its_end(suffix, place, run_cli):
    path = place / f"old{suffix}"
    assert run_cli(f"{RECORDING.format(path)} --overwrite").code == 0
    assert len(read_recording(path).times_s) > 10
    assert sorted(each.name for each in place.iterdir()) == ["old.jsonl", "old.mcap"]


@pytest.mark.parametrize("folder", ["/sys", "gone"])
@pytest.mark.parametrize("name", WRITERS)
def test_a_folder_where_nothing_can_be_written_is_said_by(name, folder, run_cli, source, tmp_path):
    words, file = WRITERS[name]
    place = folder if folder == "/sys" else tmp_path / "a" / "file" / "x"
    if folder == "gone":
        (tmp_path / "a").mkdir()
        (tmp_path / "a" / "file").write_text("")
    done = run_cli(words.format(f"{place}/{file}").replace("SOURCE", str(source)))
    assert done.code != 0
    assert file in " ".join(done.err.split())


PRINTERS = [
    "arms", "solve 0.25 0.05 0.15 --arm so101", f"where {SIM}", f"pose home {SIM} --yes",
    "workspace --arm so101",
]  # fmt: skip


@pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full")
@pytest.mark.parametrize("words", PRINTERS)
def test_a_full_stdout_is_said_of(words):
    command = [sys.executable, "-m", "ikservo", *words.split()]
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=100, check=False
        )
    assert done.returncode == 1
    assert "could not be written" in done.stderr
