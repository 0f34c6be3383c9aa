"""Mutation run: every small change of the code must make a test of its package fail.

    python tools/mutate.py [MODULE ...] [--package NAME] [--jobs N] [--list]

Each mutant is one change: a comparison, a sign, a constant, a condition, a statement left out. It
is imported in a forked process in place of the module, and the package's tests run until one
fails. Survivors are printed with their place and difference; the exit code is 1 if there are any.
Those that no test can see are excused, with the reason, in ``tools/mutation/excused.py``.
"""

from __future__ import annotations

import argparse
import os
import sys

from mutation.mutant import Mutant, mutants_of
from mutation.packages import PACKAGES, Package
from mutation.running import preload, run, time_of_tests_s

# A mutant may make a loop run on: it has this many times as long as the unchanged tests.
_PATIENCE, _GRACE_S = 4.0, 20.0


def main() -> int:
    """Run all mutants of the chosen packages and say how many were killed."""
    given = _options()
    packages = [PACKAGES[name] for name in given.package or PACKAGES]
    chosen = [
        (package, module)
        for package in packages
        for module in package.modules
        if not given.modules or module in given.modules
    ]
    if given.list:
        print(*_tried(chosen, given.line), sep="\n")
        return 0
    os.nice(5)
    preload(packages)
    survivors = [mutant for each in chosen for mutant in _run(*each, given.line, given.jobs)]
    return 1 if survivors else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("modules", nargs="*", help="modules, such as gate or ticks.joint_map (all)")
    parser.add_argument("--package", action="append", choices=list(PACKAGES), help="(all)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--list", action="store_true", help="print the mutants and run none")
    parser.add_argument("--line", type=int, help="only the mutants of one line")
    return parser.parse_args()


def _tried(chosen: list[tuple[Package, str]], line: int | None) -> list[Mutant]:
    every = (mutant for package, module in chosen for mutant in mutants_of(package, module))
    return [m for m in every if line in (None, m.line) and not m.excuse()]


def _run(package: Package, module: str, line: int | None, jobs: int) -> list[Mutant]:
    """Run the mutants of one module; print its line of the table; return who survived."""
    name = f"{package.name}.{module}"
    tried = _tried([(package, module)], line)
    taken_s = time_of_tests_s(package, module) if tried else 0.0
    if taken_s is None:
        sys.exit(f"The tests fail without any mutant of {name}.")
    survivors = run(tried, jobs, _PATIENCE * taken_s + _GRACE_S)
    excused = sum(line in (None, m.line) for m in mutants_of(package, module)) - len(tried)
    killed = len(tried) - len(survivors)
    print(f"{name}: {killed} killed, {len(survivors)} survived, {excused} excused", flush=True)
    return survivors


if __name__ == "__main__":
    sys.exit(main())
