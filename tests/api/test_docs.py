"""Every snippet of docs/api.md runs as it stands, one after the other."""

import re
from pathlib import Path

import pytest

import ikservo

ROOT = Path(__file__).parents[2]


def snippets(page):
    """Return the Python code of a page, each piece on the lines where it stands."""
    text = (ROOT / page).read_text()
    for found in re.finditer(r"```python\n(.*?)```", text, re.S):
        yield "\n" * text[: found.start(1)].count("\n") + found[1]


@pytest.mark.parametrize("page", ["docs/api.md", "README.md"])
def test_every_snippet_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    for snippet in snippets(page):
        exec(compile(snippet, page, "exec"), names)
    assert names["ikservo"] is ikservo


def test_every_public_method_of_an_arm_has_a_docstring():
    bare = [
        name
        for name in dir(ikservo.Arm)
        if not name.startswith("_") and not (getattr(ikservo.Arm, name).__doc__ or "").strip()
    ]
    assert bare == []
