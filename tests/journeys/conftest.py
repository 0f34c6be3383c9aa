"""What is done once before people sit down, and which cases of the whole matrices there are."""

import pytest

import ikservo
from tests.journeys.typed import usual_target_m


def pytest_generate_tests(metafunc):
    """Give a campaign over a whole matrix its cases, and none where ``-m`` leaves campaigns out.

    To make thousands and then to deselect them takes each process that gathers the suite seconds.
    """
    names, cases, ids = getattr(metafunc.function, "matrix", (None, None, None))
    if names is None:
        return
    left_out = "not campaign" in metafunc.config.option.markexpr
    metafunc.parametrize(names, [] if left_out else cases(), ids=ids)


@pytest.fixture(autouse=True, scope="session")
def _compiled():
    """Compile the solver now: on a busy machine it takes longer than a person waits for words."""
    model = ikservo.load_model("so101")
    ikservo.solve(model.chain, ikservo.Target(usual_target_m("so101")))
