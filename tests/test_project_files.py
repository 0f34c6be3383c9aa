"""Names in the files around the code exist and agree with pyproject.toml."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
PAGES = [ROOT / name for name in ("CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md")]


def read(name):
    return (ROOT / name).read_text("utf-8")


def test_citation_has_version_and_licence_of_package():
    fields = dict(re.findall(r"^([\w-]+): (\S+)$", read("CITATION.cff"), re.MULTILINE))
    assert fields["version"] == PROJECT["project"]["version"]
    assert fields["license"] == PROJECT["project"]["license"]


def test_every_supported_python_version_is_tested_in_ci():
    claimed = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["project"]["classifiers"]))
    (matrix,) = re.findall(r"python: (\[.*3\.12.*\])", read(".github/workflows/tests.yml"))
    assert claimed
    assert set(claimed) <= set(re.findall(r"3\.\d+", matrix))
    assert PROJECT["project"]["requires-python"] == f">={claimed[0]}"


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflow_actions_are_pinned_to_commit_with_version(path):
    for line in re.findall(r"uses: (.*)", path.read_text("utf-8")):
        assert re.fullmatch(r"\./\S+|[\w./-]+@[0-9a-f]{40} # v[\d.]+", line), line


@pytest.mark.parametrize("path", [*WORKFLOWS, ROOT / "Dockerfile", *PAGES], ids=lambda p: p.name)
def test_every_make_target_named_in_docs_exists(path):
    targets = set(re.findall(r"^([a-z-]+):", read("Makefile"), re.MULTILINE))
    text = path.read_text("utf-8").replace('["make", "', "`make ")
    found = re.findall(r"(?:run: |RUN |`|^)make ([a-z-]+)", text, re.MULTILINE)
    assert set(found) <= targets


@pytest.mark.parametrize("path", [*WORKFLOWS, *PAGES], ids=lambda path: path.name)
def test_every_file_named_in_docs_exists(path):
    text = path.read_text("utf-8")
    names = re.findall(r"\b(?:tests|tools|docs|configs|ikservo)/[\w./-]*\w", text)
    links = [name for name in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in name]
    for name in [*names, *links]:
        assert (ROOT / name).exists(), name


def test_every_listed_slow_test_exists():
    for test in read("tests/slow_tests.txt").splitlines():
        file, *_, name = test.split("::")
        assert f"def {name}(" in read(file), test
