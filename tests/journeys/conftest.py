"""What is done once before people sit down: their programs find the solver compiled."""

import pytest

import ikservo
from tests.journeys.typed import usual_target_m


@pytest.fixture(autouse=True, scope="session")
def _compiled():
    """Compile the solver now: on a busy machine it takes longer than a person waits for words."""
    model = ikservo.load_model("so101")
    ikservo.solve(model.chain, ikservo.Target(usual_target_m("so101")))
