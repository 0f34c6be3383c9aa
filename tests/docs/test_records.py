"""Records show their result first, and the documents for readers stay short."""

import pytest

from tests.docs.blocks import ROOT

RECORDS = sorted((ROOT / "docs/lab").glob("*.md"))
MOST_WORDS = 45_000  # a reader cannot look through more


@pytest.mark.parametrize("page", RECORDS, ids=lambda page: page.name)
def test_benchmark_record_begins_with_result_and_table(page):
    beginning = page.read_text("utf-8").partition("\n## ")[0].splitlines()
    table = next(i for i, line in enumerate([*beginning, "|"]) if line.startswith("|"))
    assert table < len(beginning), "a table of results before the first section"
    assert table <= 8, "at most a few lines before the table"


def test_documentation_outside_lab_stays_below_word_limit():
    pages = [page for page in (ROOT / "docs").rglob("*.md") if page not in RECORDS]
    words = sum(len(page.read_text("utf-8").split()) for page in pages)
    assert words <= MOST_WORDS, f"{words} words: move measurements to docs/lab"
