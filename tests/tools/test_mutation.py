"""The mutation tool counts a mutant as killed only where a test has failed."""

import os
import sys
from pathlib import Path

import pytest

from ikservo.guard import gate

sys.path.append(str(Path(__file__).parents[2] / "tools"))

from mutation import gathering
from mutation.mutant import mutants_of
from mutation.packages import PACKAGES
from mutation.running import is_entered, run
from mutation.swapping import function_around

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="mutants run in forked processes")
GUARD = PACKAGES["guard"]


def mutant_of(function):
    """Return the first mutant of a loaded function of the gate."""
    first = function.__code__.co_firstlineno
    mutants = mutants_of(GUARD, gate.__name__.rpartition(".")[2])
    return next(m for m in mutants if (function_around(m) or (0,))[0] == first)


def noted(test, *functions):
    """Return the notes on one test that enters some functions."""
    entered = {(f.__code__.co_filename, f.__code__.co_firstlineno) for f in functions}
    return gathering.Tests([test], cost_s=[0.1], entered=[entered])


@pytest.fixture
def mutant():
    return mutant_of(gate.Gate.allowed_advance_s)


def test_a_mutant_that_no_test_enters_has_survived(mutant, request):
    tests = noted(request.node)
    assert run([mutant], tests, jobs=1) == [mutant]
    assert not is_entered(mutant, tests)


def test_a_mutant_whose_tests_take_too_long_has_survived(mutant, request):
    tests = noted(request.node, gate.Gate.allowed_advance_s)
    assert run([mutant], tests, jobs=1, most_s=0.01) == [mutant]
    assert is_entered(mutant, tests)


def test_a_function_that_an_import_enters_is_entered(mutant, request):
    tests = noted(request.node)
    tests.while_imported = {(str(mutant.path), function_around(mutant)[0])}
    assert is_entered(mutant, tests)


def test_the_test_files_of_every_package_exist():
    assert [
        file for package in PACKAGES.values() for file in package.tests() if not file.exists()
    ] == []
