"""Number of seeds per test: a few in the suite, many in a campaign, which has parts."""

import os
import sys

import pytest


def part_of(many):
    """Return the seeds of a campaign, or of a part: IKSERVO_PART=2/4 is the second of four.

    Parts may run in parallel; a small one, 1/100, shows how long the whole campaign takes.
    """
    number, parts = (int(word) for word in os.environ.get("IKSERVO_PART", "1/1").split("/"))
    first, last = (-(-k * many // parts) for k in (number - 1, number))
    return range(first, last)


def few_or_many(few, many):
    """Run a test over a few seeds, or over many of them in a campaign."""
    return pytest.mark.parametrize("seeds", [pytest.param(range(few), id="few"), campaign(many)])


def campaign(many):
    marks = (pytest.mark.campaign, pytest.mark.timeout(0))
    return pytest.param(part_of(many), id="many", marks=marks)


def spread(seed):
    """Return a number from 0 to 1; the numbers of consecutive seeds are spread evenly."""
    return seed * 0.6180339887498949 % 1.0


def log(capsys, text):
    """Print a result although the output is captured."""
    with capsys.disabled():
        sys.stdout.write(f"\n  {text}\n")
