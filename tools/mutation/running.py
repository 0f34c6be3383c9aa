"""Mutants in processes of their own, each until the first test fails."""

from __future__ import annotations

import importlib
import itertools
import math
import mmap
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FunctionType

import pytest

from mutation.gathering import OPTIONS, Failures, Tests
from mutation.mutant import Mutant
from mutation.packages import ROOT
from mutation.swapping import (
    Name,
    NotLoadedError,
    constants_around,
    function_around,
    functions_of,
    import_anew,
    put_constants_in,
    put_in,
)

__all__ = ["is_entered", "preload", "run"]

_POLL_S = 0.005
_SURVIVED, _KILLED, _NOT_LOADED = 1, 0, 2
# A mutant may make a loop run on: a test then has this many times as long as without it.
_TIMEOUT_S, _GRACE_S = 3.0, 2.0
# Importing everything again takes a few seconds, and kernels as plain Python are slow.
_IMPORT_S, _PLAIN = 10.0, 30.0
# A mutant may also wait for what never comes, which takes no time of the processor; others may
# take most of that time.
_WALL_S, _WALL = 60.0, 10.0
# How much likelier a test named after the module is to fail than another.
_OWN, _OTHER = 1.0, 0.2


def preload() -> None:
    """Import once what every mutant's process needs and what does not change."""
    sys.path[:0] = [str(ROOT), str(ROOT / "sim")]
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    os.chdir(ROOT)
    for name in ("numpy", "scipy.optimize"):
        importlib.import_module(name)
    from hypothesis import HealthCheck, Phase, settings  # noqa: PLC0415  # after numpy's threads

    settings.register_profile(
        "mutation",
        derandomize=True,
        database=None,
        deadline=None,
        phases=(Phase.explicit, Phase.generate),  # no matter how small an example is
        suppress_health_check=tuple(HealthCheck),
    )
    settings.load_profile("mutation")


def run(
    mutants: Sequence[Mutant], tests: Tests, jobs: int, most_s: float = math.inf
) -> list[Mutant]:
    """Return those mutants of one module that no test killed.

    For each of them tests are run that take so many seconds in all, the likeliest to fail first.

    What is changed inside of a function or in a constant is put into the module as it is loaded.
    Where it lives on although it acts while modules are imported already, or the change is
    somewhere else, everything is imported again.
    """
    if not mutants:
        return []
    module = _Module(mutants[0], tests, most_s)
    kernel = mutants[0].module == mutants[0].package.kernel  # whose Python code is not entered
    inside = [m for m in mutants if not kernel and (function_around(m) or constants_around(m))]
    longest_s = module.longest_s(plain=False)
    alive, not_loaded = _in_children(inside, module.survives_inside, jobs, longest_s)
    again = [m for m in alive if _acts_early(m, tests)]
    anew = [m for m in mutants if m not in inside or m in again or m in not_loaded]
    longest_s = module.longest_s(plain=mutants[0].package.is_plain(mutants[0].module))
    alive_anew, _ = _in_children(anew, module.survives_anew, jobs, longest_s)
    alive = [m for m in alive if m not in again] + alive_anew
    return [m for m in mutants if m in alive]


def is_entered(mutant: Mutant, tests: Tests) -> bool:
    """Return whether a test, or an import, enters the function that is changed.

    True where the change is in no function.
    """
    around = function_around(mutant)
    if around is None:
        return True
    return bool(tests.of(mutant.path, *around)) or _acts_early(mutant, tests)


def _acts_early(mutant: Mutant, tests: Tests) -> bool:
    """Return whether what is changed may be used while modules are imported."""
    around = function_around(mutant)
    if around is None:
        return True
    first, last = around
    early = tests.while_imported
    return any(file == str(mutant.path) and first <= n <= last for file, n in early)


@dataclass(slots=True, init=False)
class _Module:
    """A module's tests and functions; its methods run in the processes of mutants."""

    tests: Tests
    own: set[int]
    functions: dict[Name, list[FunctionType]]
    kills: mmap.mmap
    most_s: float

    def __init__(self, mutant: Mutant, tests: Tests, most_s: float) -> None:
        self.tests, self.most_s = tests, most_s
        package, module = mutant.package, mutant.module
        self.own = {i for i, t in enumerate(tests.items) if package.is_own(module, t.path)}
        self.functions = functions_of(mutant.path)
        self.kills = mmap.mmap(-1, len(tests.items))  # shared by all processes

    def longest_s(self, *, plain: bool) -> float:
        """Return how long a mutant may take in all."""
        return (_PLAIN if plain else _WALL) * sum(self.tests.cost_s) + _WALL_S

    def survives_inside(self, mutant: Mutant) -> bool:
        """Run the tests that use what is changed; return whether all of them passed."""
        around = function_around(mutant)
        if around:
            put_in(mutant, self.functions)
            entering = self._likeliest(self.tests.of(mutant.path, *around))
        else:
            put_constants_in(mutant)
            entering = self._likeliest(self._using(mutant))
        failures = Failures()
        for i, following in itertools.zip_longest(entering, entering[1:]):
            item = self.tests.items[i]
            item.config.pluginmanager.register(failures)
            _limit(_TIMEOUT_S * self.tests.cost_s[i] + _GRACE_S)
            after = None if following is None else self.tests.items[following]
            item.ihook.pytest_runtest_protocol(item=item, nextitem=after)
            item.config.pluginmanager.unregister(failures)
            if failures.any:
                self.kills[i] = min(255, self.kills[i] + 1)
                return False
        return True

    def survives_anew(self, mutant: Mutant) -> bool:
        """Import the mutant and the tests of its module; return whether all of them passed."""
        using = self._using(mutant)
        if mutant.module == mutant.package.kernel:
            using = sorted(self.own)
        using = self._likeliest(using)
        cost_s = sum(self.tests.cost_s[i] for i in using)
        slower = _PLAIN if mutant.package.is_plain(mutant.module) else _TIMEOUT_S
        _limit(slower * cost_s + _IMPORT_S)
        import_anew(mutant)
        rounds = [i for i in using if i in self.own], [i for i in using if i not in self.own]
        names = [[self.tests.items[i].nodeid for i in each] for each in rounds if each]
        return all(pytest.main(["-x", *OPTIONS, *each]) == 0 for each in names)

    def _using(self, mutant: Mutant) -> list[int]:
        """Return the tests of files that enter the module or are named after it, else all."""
        items = self.tests.items
        files = {items[i].path for i in [*self.tests.of(mutant.path), *self.own]}
        every = range(len(items))
        return [i for i in every if items[i].path in files] or list(every)

    def _likeliest(self, tests: Sequence[int]) -> list[int]:
        """Return tests, the most effective for their time first, within the time."""
        ordered = sorted(tests, key=self._cost_of_a_kill)
        so_far_s = itertools.accumulate(self.tests.cost_s[i] for i in ordered)
        return [i for i, cost_s in zip(ordered, so_far_s, strict=True) if cost_s <= self.most_s]

    def _cost_of_a_kill(self, i: int) -> float:
        likely = self.kills[i] + (_OWN if i in self.own else _OTHER)
        return self.tests.cost_s[i] / likely


def _limit(cpu_s: float) -> None:
    """End this process when it has taken so long of the processor, from now on."""
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, cpu_s)


def _in_children(
    mutants: Sequence[Mutant], survives: Callable[[Mutant], bool], jobs: int, longest_s: float
) -> tuple[list[Mutant], list[Mutant]]:
    """Return the mutants that survived, and those whose function is not loaded."""
    waiting = list(reversed(mutants))
    ended: dict[int, list[Mutant]] = {_SURVIVED: [], _NOT_LOADED: []}
    running: dict[int, _Child] = {}
    while waiting or running:
        while waiting and len(running) < jobs:
            child = _Child(waiting.pop(), Path(tempfile.mkdtemp(prefix="m", dir=_memory())))
            running[_fork(child, survives)] = child
        for pid, child in list(running.items()):
            code = _code_of(pid, late=time.monotonic() - child.began_s > longest_s)
            if code is not None:
                del running[pid]
                shutil.rmtree(child.folder, ignore_errors=True)
                ended.setdefault(code, []).append(child.mutant)
        time.sleep(_POLL_S)
    return ended[_SURVIVED], ended[_NOT_LOADED]


@dataclass(frozen=True, slots=True)
class _Child:
    """What a process runs, where its files are, and since when it runs."""

    mutant: Mutant
    folder: Path
    began_s: float = field(default_factory=time.monotonic)


def _memory() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def _code_of(pid: int, *, late: bool) -> int | None:
    """Return the exit code of a process that has ended, or is ended because it takes too long."""
    ended, status = os.waitpid(pid, os.WNOHANG)
    if not ended and not late:
        return None
    if not ended:
        os.kill(pid, signal.SIGKILL)
        status = os.waitpid(pid, 0)[1]
    return os.WEXITSTATUS(status) if os.WIFEXITED(status) else _KILLED


def _fork(child: _Child, survives: Callable[[Mutant], bool]) -> int:
    """Start a mutant's process and return its id."""
    pid = os.fork()
    if pid:
        return pid
    code = _KILLED
    try:
        devnull = os.open(os.devnull, os.O_WRONLY)
        os.dup2(devnull, 1)
        os.dup2(devnull, 2)
        os.environ["PYTEST_DEBUG_TEMPROOT"] = str(child.folder)
        code = _SURVIVED if survives(child.mutant) else _KILLED
    except NotLoadedError:
        code = _NOT_LOADED
    except BaseException:  # a mutant that cannot be imported is killed, too
        code = _KILLED
    finally:
        os._exit(code)
    return 0
