"""Run tests on one arm of the simulated family if they name none.

``FAMILY_SEED=301 python -m pytest -p tests.family_seed tests/arm/test_gripper.py``: backlash,
friction, torque, masses and supply are those of that arm, not the nominal ones.
"""

import os

from servosim import port

SEED = int(os.environ["FAMILY_SEED"])
make_nominal_world = port.make_arm_world


def make_arm_world(arm, pose, seed, **how):
    return make_nominal_world(arm, pose, SEED if seed is None else seed, **how)


port.make_arm_world = make_arm_world
