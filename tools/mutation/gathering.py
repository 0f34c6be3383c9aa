"""The tests of a package, gathered once, and which functions each of them enters."""

from __future__ import annotations

import os
import pickle
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, FrameType

import pytest

from mutation.packages import Package

__all__ = ["OPTIONS", "Failures", "Tests", "with_tests"]

OPTIONS = ("-q", "-s", "-p", "no:cacheprovider", "--timeout=0", "--assert=plain")
OPTIONS += ("-W", "ignore::pytest.PytestAssertRewriteWarning")

Place = tuple[str, int]
"""A file, and the first line of a function in it."""
_Row = tuple[float, set[Place]]


@dataclass(slots=True)
class Tests:
    """Tests that pass on the unchanged package.

    Attributes:
        items: The tests.
        cost_s: What each takes of the processor, entered functions being noted.
        entered: The package's functions that each enters.
        while_imported: Those that are called while modules and tests are imported.
    """

    items: list[pytest.Item]
    cost_s: list[float] = field(default_factory=list[float])
    entered: list[set[Place]] = field(default_factory=list[set[Place]])
    while_imported: set[Place] = field(default_factory=set[Place])

    def of(self, path: Path, first: int = 0, last: int = 1 << 30) -> list[int]:
        """Return the tests that enter a function between two lines of a file."""
        places = ({line for file, line in each if file == str(path)} for each in self.entered)
        return [i for i, lines in enumerate(places) if any(first <= n <= last for n in lines)]


class Failures:
    """A pytest plugin that remembers whether a test failed."""

    def __init__(self) -> None:
        self.any = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Record the result of a test."""
        self.any = self.any or report.failed


class _Noting:
    """Notes which functions below a folder are entered."""

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder)
        self._codes: dict[int, CodeType] = {}  # to hash a code object takes long

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        self._codes[id(frame.f_code)] = frame.f_code

    def start(self) -> None:
        self._codes.clear()
        threading.settrace(self)
        sys.settrace(self)

    def stop(self) -> set[Place]:
        sys.settrace(None)
        threading.settrace(None)  # pyright: ignore[reportArgumentType]
        ours = (c for c in self._codes.values() if c.co_filename.startswith(self._folder))
        return {(c.co_filename, c.co_firstlineno) for c in ours}


class _InPlaceOfRunning:
    """A pytest plugin that does something else with the gathered tests than to run them."""

    def __init__(self, noting: _Noting, work: Callable[[Tests], None]) -> None:
        self._noting, self._work = noting, work

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Note what the tests enter, in a process of their own; then do the work."""
        while_imported = self._noting.stop()
        if session.testsfailed:
            sys.exit("The tests cannot be imported without any mutant.")
        tests = _noted(session.items, self._noting)
        tests.while_imported = while_imported
        self._work(tests)
        return True


def with_tests(package: Package, files: Sequence[Path], work: Callable[[Tests], None]) -> None:
    """Gather tests and do something with them, in this process."""
    noting = _Noting(package.folder)
    noting.start()
    plugin = _InPlaceOfRunning(noting, work)
    code = pytest.main([*OPTIONS, *map(str, files)], plugins=[plugin])
    if code not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
        sys.exit(f"pytest ended with {code!r}.")


def _noted(items: list[pytest.Item], noting: _Noting) -> Tests:
    """Run all tests in a child, so that nothing stays behind; leave out those that fail."""
    with tempfile.TemporaryFile() as file, tempfile.TemporaryDirectory() as folder:
        pid = os.fork()
        if not pid:
            os.environ["PYTEST_DEBUG_TEMPROOT"] = folder
            _note_and_exit(items, noting, file.fileno())
        if os.waitpid(pid, 0)[1]:
            sys.exit("The tests end the process without any mutant.")
        file.seek(0)
        rows: list[_Row | None] = pickle.loads(file.read())  # written by our own child
    tests = Tests([])
    for item, row in zip(items, rows, strict=True):
        if row is None:
            print(f"left out, as it fails without any mutant: {item.nodeid}", flush=True)
        else:
            tests.items.append(item)
            tests.cost_s.append(row[0])
            tests.entered.append(row[1])
    return tests


def _note_and_exit(items: list[pytest.Item], noting: _Noting, file: int) -> None:
    rows: list[_Row | None] = []
    code = 1
    try:
        for item, following in zip(items, [*items[1:], None], strict=True):
            failures = Failures()
            item.config.pluginmanager.register(failures)
            began_s = time.process_time()
            noting.start()
            item.ihook.pytest_runtest_protocol(item=item, nextitem=following)
            entered = noting.stop()
            item.config.pluginmanager.unregister(failures)
            cost_s = time.process_time() - began_s
            rows.append(None if failures.any else (cost_s, entered))
        os.write(file, pickle.dumps(rows))
        code = 0
    finally:
        os._exit(code)
