"""Warm-up of the solver, and the cases of the whole matrices."""

import pytest

import ikservo
from tests.journeys.command_arguments import usual_target_m


def pytest_generate_tests(metafunc):
    """Give a campaign over a whole matrix its cases, and none where ``-m`` deselects campaigns.

    Making thousands only to deselect them costs each collecting process seconds.
    """
    names, cases, ids = getattr(metafunc.function, "matrix", (None, None, None))
    if names is None:
        return
    left_out = "not campaign" in metafunc.config.option.markexpr
    metafunc.parametrize(names, [] if left_out else cases(), ids=ids)


@pytest.fixture(autouse=True, scope="session")
def _compiled():
    """Compile the solver now: on a busy machine it takes longer than the tests' timeouts."""
    model = ikservo.load_model("so101")
    ikservo.solve(model.chain, ikservo.Target(usual_target_m("so101")))
