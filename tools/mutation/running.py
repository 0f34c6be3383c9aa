"""Mutants in processes of their own, each until the first test fails."""

from __future__ import annotations

import contextlib
import importlib.abc
import importlib.util
import io
import os
import signal
import sys
import time
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType

from mutation.mutant import Mutant, unchanged
from mutation.packages import ROOT, Package

__all__ = ["preload", "run", "time_of_tests_s"]

_LONGEST_S = 300.0
_POLL_S = 0.005
_SURVIVED, _KILLED = 1, 0


def preload(packages: Sequence[Package]) -> None:
    """Import once what every mutant's process needs and what does not change."""
    sys.path[:0] = [str(ROOT), str(ROOT / "sim")]
    os.chdir(ROOT)
    for name in ("pytest", "hypothesis", "numpy", "scipy.optimize", "numba"):
        importlib.import_module(name)
    for package in packages:
        if package.kernel:
            importlib.import_module(f"ikservo.{package.name}.{package.kernel}")


def time_of_tests_s(package: Package, module: str) -> float | None:
    """Return how long the tests take on the unchanged module; None where they fail."""
    began_s = time.monotonic()
    _, status = os.waitpid(_fork(unchanged(package, module)), 0)
    passed = os.WIFEXITED(status) and os.WEXITSTATUS(status) == _SURVIVED
    return time.monotonic() - began_s if passed else None


def run(mutants: Sequence[Mutant], jobs: int, longest_s: float = _LONGEST_S) -> list[Mutant]:
    """Return the mutants that no test killed; one that takes too long counts as killed."""
    waiting, survivors = list(reversed(mutants)), list[Mutant]()
    running: dict[int, tuple[Mutant, float]] = {}
    done = 0
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            running[_fork(mutant)] = (mutant, time.monotonic())
        for pid in list(running):
            mutant, started_s = running[pid]
            status = _ended(pid, late=time.monotonic() - started_s > longest_s)
            if status is None:
                continue
            del running[pid]
            done += 1
            if os.WIFEXITED(status) and os.WEXITSTATUS(status) == _SURVIVED:
                survivors.append(mutant)
                print(mutant, flush=True)
            if done % 50 == 0:
                print(f"{done} of {len(mutants)} ...", file=sys.stderr, flush=True)
        time.sleep(_POLL_S)
    return survivors


def _ended(pid: int, *, late: bool) -> int | None:
    """Return the status of a process that has ended, or is ended because it takes too long."""
    ended, status = os.waitpid(pid, os.WNOHANG)
    if ended:
        return status
    if not late:
        return None
    os.kill(pid, signal.SIGKILL)
    return os.waitpid(pid, 0)[1]


def _fork(mutant: Mutant) -> int:
    """Start a mutant's process and return its id."""
    pid = os.fork()
    if pid:
        return pid
    code = _KILLED
    try:
        devnull = os.open(os.devnull, os.O_WRONLY)
        os.dup2(devnull, 1)
        os.dup2(devnull, 2)
        code = _SURVIVED if _survives(mutant) else _KILLED
    except BaseException:  # a mutant that cannot be imported is as dead as one that fails a test
        code = _KILLED
    finally:
        os._exit(code)
    return 0


def _survives(mutant: Mutant) -> bool:
    """Run the tests on a mutant, in this process; return whether all of them passed."""
    import pytest  # noqa: PLC0415  # preloaded, but only in the processes of mutants

    _forget(mutant)
    sys.meta_path.insert(0, _Swap(mutant))
    options = ["-x", "-q", "-p", "no:cacheprovider", "--no-header", "--timeout=0"]
    options += ["--assert=plain", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
    rounds = mutant.package.tests_of(mutant.module)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return all(pytest.main([*options, *files]) == 0 for files in rounds)


def _forget(mutant: Mutant) -> None:
    """Let everything of ours be imported anew, except compiled kernels that are not mutated."""
    kernel = f"ikservo.{mutant.package.name}.{mutant.package.kernel}"
    keep = {kernel, "ikservo.ik.kernel.compiling"} if mutant.package.kernel else set[str]()
    if mutant.dotted == kernel:
        import numba  # noqa: PLC0415  # see above

        numba.config.DISABLE_JIT = True
        keep = set[str]()
    for name in list(sys.modules):
        if name.split(".")[0] in ("ikservo", "servosim", "tests") and name not in keep:
            del sys.modules[name]


class _Swap(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports a mutant in place of its module."""

    def __init__(self, mutant: Mutant) -> None:
        self._mutant = mutant

    def find_spec(
        self, fullname: str, path: object = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Answer for the mutated module only."""
        if fullname != self._mutant.dotted:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=str(self._mutant.path))

    def exec_module(self, module: ModuleType) -> None:
        """Run the mutant's code as the module's."""
        code = compile(self._mutant.tree, str(self._mutant.path), "exec")
        exec(code, module.__dict__)
