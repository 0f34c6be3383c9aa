import numpy as np
import pytest

from ikservo.kinematics.bending_and_backlash import Bending
from ikservo.kinematics.dynamics import Dynamics
from ikservo.model import load_model
from ikservo.model.arm_model import link_masses

from .arms import SimulatedArm


@pytest.fixture(scope="session")
def dynamics():
    model = load_model("so101")
    return Dynamics.from_masses(model.chain, link_masses(model, model.chain))


@pytest.fixture
def make_arm(dynamics):
    def make(seed=0, zeros=3.0, compliance=0.15, half_play=0.3):
        chance = np.random.default_rng(seed)
        n = dynamics.chain.dof
        lifts = np.array([0.0, 1.0, 1.0, 1.0, 0.0])
        bending = Bending(
            dynamics,
            lifts * chance.uniform(0.0, compliance, n),
            lifts * np.radians(chance.uniform(0.0, half_play, n)),
        )
        return SimulatedArm(bending, np.radians(chance.uniform(-zeros, zeros, n)), chance)

    return make
