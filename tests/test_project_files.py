"""What the files around the code name exists, and agrees with pyproject.toml."""

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


def test_the_citation_has_the_version_and_licence_of_the_package():
    fields = dict(re.findall(r"^([\w-]+): (\S+)$", read("CITATION.cff"), re.MULTILINE))
    assert fields["version"] == PROJECT["project"]["version"]
    assert fields["license"] == PROJECT["project"]["license"]


def test_every_python_that_is_claimed_is_tested_and_none_is_older():
    claimed = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["project"]["classifiers"]))
    (matrix,) = re.findall(r"python: (\[.*3\.12.*\])", read(".github/workflows/tests.yml"))
    assert claimed
    assert set(claimed) <= set(re.findall(r"3\.\d+", matrix))
    assert PROJECT["project"]["requires-python"] == f">={claimed[0]}"


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_every_action_of_a_workflow_is_pinned_to_a_commit_with_its_version(path):
    for line in re.findall(r"uses: (.*)", path.read_text("utf-8")):
        assert re.fullmatch(r"\./\S+|[\w./-]+@[0-9a-f]{40} # v[\d.]+", line), line


@pytest.mark.parametrize("path", [*WORKFLOWS, ROOT / "Dockerfile", *PAGES], ids=lambda p: p.name)
def test_every_target_of_make_that_is_named_exists(path):
    targets = set(re.findall(r"^([a-z-]+):", read("Makefile"), re.MULTILINE))
    text = path.read_text("utf-8").replace('["make", "', "`make ")
    found = re.findall(r"(?:run: |RUN |`|^)make ([a-z-]+)", text, re.MULTILINE)
    assert set(found) <= targets


@pytest.mark.parametrize("path", [*WORKFLOWS, *PAGES], ids=lambda path: path.name)
def test_every_file_that_is_named_exists(path):
    text = path.read_text("utf-8")
    names = re.findall(r"\b(?:tests|tools|docs|configs|ikservo)/[\w./-]*\w", text)
    links = [name for name in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in name]
    for name in [*names, *links]:
        assert (ROOT / name).exists(), name
