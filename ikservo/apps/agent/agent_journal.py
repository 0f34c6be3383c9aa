"""The journal of an agent: one JSON line for each call, plan, answer and result."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

from ikservo.errors import FileFormatError, InputError, printable
from ikservo.files.reading import config_dir, read_text
from ikservo.files.writing import FileWriteError, make_folder

MAX_BYTES = 20_000_000
"""Size at which a journal is full, bytes; if no entry can be written, the arm does not move."""

_MAX_TEXT = 1000  # longest logged value, characters


class AgentJournal:
    """Writer of a new journal file; thread-safe.

    Args:
        arm: The name of the arm, a part of the file's name.
        folder: The folder of the journals; the user's own folder if None.

    Raises:
        FileWriteError: The file cannot be created.
    """

    def __init__(self, arm: str, folder: Path | None = None) -> None:
        folder = folder or journal_folder()
        make_folder(folder)
        stamp = datetime.now(UTC).strftime("%Y%m%d-%H%M%S-%f")
        self.path = folder / f"{stamp}-{arm}.jsonl"
        self._lock = threading.Lock()
        self.write("started", arm=arm)

    def write(self, event: str, **values: object) -> None:
        """Append an event, and sync it to the disk.

        Raises:
            FileWriteError: The disk is full or read-only, or the journal is full.
        """
        line = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "event": event}
        text = json.dumps(line | {key: _bounded(each) for key, each in values.items()}) + "\n"
        with self._lock:
            try:
                self.path.touch(0o600)
                with self.path.open("a", encoding="utf-8") as file:
                    if file.tell() > MAX_BYTES:
                        raise FileWriteError(self.path, "the journal is full; restart the server")
                    file.write(text)
                    file.flush()
                    os.fsync(file.fileno())
            except FileWriteError:
                raise
            except OSError as error:
                raise FileWriteError(self.path, error.strerror or str(error)) from None


def journal_folder() -> Path:
    """Return the folder of the user's journals."""
    return config_dir() / "agent"


def latest_journal() -> Path:
    """Return the newest journal.

    Raises:
        InputError: There is no journal.
    """
    found = sorted(journal_folder().glob("*.jsonl"))
    if not found:
        raise InputError("There is no journal of an agent.", "Run `ikservo mcp` first.")
    return found[-1]


def read_journal(path: Path) -> Iterator[str]:
    """Yield each event of a journal as one line of text.

    Raises:
        FileFormatError: The file cannot be read, or a line is not an event.
    """
    lines = read_text(path, 2 * MAX_BYTES).splitlines()
    for number, line in enumerate(lines, 1):
        try:
            event = json.loads(line)
            time, name = str(event.pop("time")), str(event.pop("event"))
        except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
            raise FileFormatError(path, f"line {number}", "is not an event", "JSON lines") from None
        rest = ", ".join(f"{key}: {value}" for key, value in cast("dict[str, Any]", event).items())
        yield printable(f"{time[11:19]}  {name:<9} {rest}".replace("\n", " "))


def _bounded(value: object) -> object:
    if isinstance(value, bool | int | float | None):
        return value
    text = value if isinstance(value, str) else json.dumps(value, default=str)
    return text if len(text) <= _MAX_TEXT else f"{text[:_MAX_TEXT]}…"
