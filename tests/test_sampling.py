"""Cases of a test that the suite runs, and those of the campaign."""

from types import SimpleNamespace

import pytest

from tests.sampling import leave_others_to_campaign


class Case:
    """A collected case of a test, with its markers."""

    def __init__(self, test, *marks):
        self.parent, self.originalname = SimpleNamespace(nodeid="tests/test_it.py"), test
        self.marks = list(marks)

    def get_closest_marker(self, name):
        return next((mark for mark in self.marks if mark.name == name), None)

    def add_marker(self, mark):
        self.marks.append(mark.mark)

    @property
    def is_in_suite(self):
        return self.get_closest_marker("campaign") is None


SAMPLE_2, CAMPAIGN = pytest.mark.sample(2).mark, pytest.mark.campaign.mark


def kept(cases):
    leave_others_to_campaign(cases)
    return [i for i, case in enumerate(cases) if case.is_in_suite]


def cases_of(test, count=9):
    return [Case(test, SAMPLE_2) for _ in range(count)]


def test_sample_marker_selects_same_cases_in_each_run():
    assert len(kept(cases_of("test_a"))) == 2
    assert kept(cases_of("test_a")) == kept(cases_of("test_a"))


def test_sample_marker_selects_other_cases_for_other_tests():
    assert len({tuple(kept(cases_of(f"test_{i}"))) for i in range(9)}) > 4


def test_sample_marker_selects_cases_per_test():
    cases = cases_of("test_a") + cases_of("test_b")
    assert [i for i in kept(cases) if i < 9] == kept(cases_of("test_a"))


def test_sample_marker_ignores_campaign_cases():
    cases = [Case("test_a", SAMPLE_2, CAMPAIGN), *cases_of("test_a", 2)]
    assert kept(cases) == [1, 2]


def test_sample_marker_keeps_case_requested_by_its_id():
    assert kept(cases_of("test_a", 1)) == [0]


def test_every_case_is_kept_without_sample_marker():
    assert kept([Case("test_a"), Case("test_a")]) == [0, 1]
