"""The suite runs a few of the many cases of a test, the campaign the others.

``@pytest.mark.sample(3)`` above a parametrised test: three cases, drawn with the test's name as the
seed. Other tests draw other cases, so that together they have every arm and every kind of case.
"""

import random
from collections import defaultdict

import pytest


def leave_others_to_campaign(items):
    """Mark the cases that were not drawn; if a test is named on the command line, mark none."""
    tests = defaultdict(list)
    for item in items:
        if item.get_closest_marker("sample") and not item.get_closest_marker("campaign"):
            tests[item.parent.nodeid, item.originalname].append(item)
    for (_, name), cases in tests.items():
        for item in set(cases) - set(draw(name, cases)):
            item.add_marker(pytest.mark.campaign)


def draw(name, cases):
    """Return the cases that the suite runs."""
    (count,) = cases[0].get_closest_marker("sample").args
    return random.Random(name).sample(cases, min(count, len(cases)))
