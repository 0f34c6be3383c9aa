"""The tests that have to notice mutants are there: a renamed file must not end the run."""

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = runpy.run_path(str(ROOT / "tools" / "mutation" / "packages.py"))["PACKAGES"]


@pytest.mark.parametrize("name", PACKAGES)
def test_every_test_file_of_a_mutated_package_exists(name):
    assert [str(file) for file in PACKAGES[name].tests() if not file.is_file()] == []


@pytest.mark.parametrize("name", PACKAGES)
def test_what_is_left_out_is_the_name_of_a_test_file(name):
    files = [file.name for file in (ROOT / "tests" / name).glob("test_*.py")]
    for part in PACKAGES[name].left_out:
        assert any(part in file for file in files), part


@pytest.mark.parametrize("name", PACKAGES)
def test_modules_named_apart_exist(name):
    package = PACKAGES[name]
    for module in (package.kernel, *package.layouts):
        assert not module or package.path_of(module).is_file(), module
