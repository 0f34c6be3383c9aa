"""Mutation run: every small change of the code must make a test of its package fail.

    python tools/mutate.py [MODULE ...] [--package NAME] [--jobs N] [--list]
                           [--line N ...] [--tests FILE ...] [--sample FRACTION --seed N]
                           [--most-s SECONDS]

Each mutant is one change: a comparison, a sign, a constant, a condition, a statement left out. It
is put in place of the original in a forked process, and the tests that call what is changed run
there until one fails. Survivors are printed with their place and difference, and whether no test
enters what is changed; the exit code is 1 if there are any. Equivalent mutants are excused, with
the reason, in ``tools/mutation/excused.py``.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import sys
from pathlib import Path

from mutation.gathering import Tests, with_tests
from mutation.mutant import Mutant, mutants_of
from mutation.packages import PACKAGES, Package
from mutation.running import is_entered, preload, run

_MOST = "tests of so many seconds in all for each mutant, the likeliest to fail (all)"


def main() -> int:
    """Run all mutants of the chosen packages and print how many were killed."""
    given = _options()
    survivors = 0
    if not given.list:
        os.nice(5)
        preload()
    for package in (PACKAGES[name] for name in given.package or PACKAGES):
        tried = {m: _tried(package, m, given) for m in package.modules if _is_chosen(m, given)}
        tried = {module: mutants for module, mutants in tried.items() if mutants}
        if given.list:
            print(*(mutant for mutants in tried.values() for mutant in mutants), sep="\n")
        elif tried:
            survivors += _run(package, tried, given)
    return 1 if survivors else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("modules", nargs="*", help="modules, such as gate or ticks.joint_map (all)")
    parser.add_argument("--package", action="append", choices=list(PACKAGES), help="(all)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--list", action="store_true", help="print the mutants and run none")
    parser.add_argument("--line", type=int, action="append", help="only the mutants of this line")
    parser.add_argument("--tests", type=Path, action="append", help="only this test file (all)")
    parser.add_argument("--sample", type=float, default=1.0, help="run this fraction of them only")
    parser.add_argument("--seed", type=int, default=1, help="which ones those are")
    parser.add_argument("--most-s", type=float, default=math.inf, help=_MOST)
    return parser.parse_args()


def _is_chosen(module: str, given: argparse.Namespace) -> bool:
    return not given.modules or module in given.modules


def _tried(package: Package, module: str, given: argparse.Namespace) -> list[Mutant]:
    """Return the mutants of a module to run: the same ones for the same seed."""
    chance = random.Random(f"{given.seed} {package.name}.{module}")  # not a secret
    sample = (m for m in mutants_of(package, module) if chance.random() < given.sample)
    return [m for m in sample if (not given.line or m.line in given.line) and not m.excuse()]


def _run(package: Package, tried: dict[str, list[Mutant]], given: argparse.Namespace) -> int:
    """Run the mutants of a package, print a line of the table for each module, count survivors."""
    survivors: list[Mutant] = []

    def work(tests: Tests) -> None:
        for module, mutants in tried.items():
            alive = run(mutants, tests, given.jobs, given.most_s)
            survivors.extend(alive)
            excused = sum(bool(m.excuse()) for m in mutants_of(package, module))
            counts = f"{len(mutants) - len(alive)} killed, {len(alive)} survived"
            described = [_describe(mutant, tests) for mutant in alive]
            print(*described, f"{package.name}.{module}: {counts}, {excused} excused", sep="\n")
            sys.stdout.flush()

    with_tests(package, given.tests or package.tests(), work)
    return len(survivors)


def _describe(mutant: Mutant, tests: Tests) -> str:
    """Return place and difference of a survivor, and whether no test enters its function."""
    return str(mutant) if is_entered(mutant, tests) else f"{mutant}no test enters it\n"


if __name__ == "__main__":
    sys.exit(main())
