"""A tick must be a whole number; values that only look like one are refused."""

import numpy as np
import pytest

from ikservo.errors import RefusedError
from ikservo.guard.driven_joint import require_int_tick


@pytest.mark.parametrize("tick", [0, -1, 4095, 10**9])
def test_tick_type_check_accepts_integers(tick):
    require_int_tick("elbow", tick)


@pytest.mark.parametrize("tick", [0.0, float("nan"), True, False, "1", None, np.int64(3), [1]])
def test_tick_type_check_refuses_other_types(tick):
    with pytest.raises(RefusedError, match="The goal of elbow is"):
        require_int_tick("elbow", tick)
