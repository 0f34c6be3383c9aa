"""Pinocchio's torques for the joints of a chain: held joints are locked, followers counted."""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio

import ikservo
from ikservo.kinematics import Chain, JointType, Mimic
from ikservo.kinematics.inertia import LinkMass
from ikservo.kinematics.se3 import exp_so3, make_pose
from ikservo.model.arm_model import link_masses
from tests.kinematics.chains import crane_joints, joint
from tests.oracle import ARMS, CONFIGS

# Pinocchio stores a tensor as xx xy yy xz yz zz, URDF as xx xy xz yy yz zz.
URDF_ORDER = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]


@dataclass(frozen=True)
class Oracle:
    """A chain with masses, and Pinocchio's model of its moving joints.

    ``moving`` has for each moving joint its link, its entry of q, and scale and shift of its value.
    """

    chain: Chain
    masses: list[LinkMass]
    model: pinocchio.Model
    moving: dict[str, tuple[str, int, float, float]]
    tip: tuple[int, pinocchio.SE3]

    def with_payload(self, mass_kg, centre_m, tensor):
        model = self.model.copy()
        joint_id, placement = self.tip
        inertia = pinocchio.Inertia(mass_kg, np.array(centre_m), np.array(tensor))
        model.appendBodyToJoint(joint_id, inertia, placement)
        return replace(self, model=model)

    def with_gravity(self, gravity_m_s2):
        model = self.model.copy()
        model.gravity.linear = np.array(gravity_m_s2)
        return replace(self, model=model)

    def sample(self, random):
        """Return q inside the limits, rates and accelerations."""
        chain = self.chain
        low, high = np.maximum(chain.lower_rad, -4.0), np.minimum(chain.upper_rad, 4.0)
        qd, qdd = random.uniform(-1.0, 1.0, (2, chain.dof))
        return random.uniform(low, high), 4.0 * qd, 30.0 * qdd

    def torques(self, q, qd, qdd):
        state = self._state(q, qd, qdd)
        return self._gears().T @ pinocchio.rnea(self.model, self.model.createData(), *state)

    def gravity(self, q):
        posture = self._state(q, q, q)[0]
        data = self.model.createData()
        return self._gears().T @ pinocchio.computeGeneralizedGravity(self.model, data, posture)

    def inertia_matrix(self, q):
        upper = np.triu(
            pinocchio.crba(self.model, self.model.createData(), self._state(q, q, q)[0])
        )
        return self._gears().T @ (upper + np.triu(upper, 1).T) @ self._gears()

    def regressor(self, q, qd, qdd, links):
        """Return the regressor, ten columns for each link of that list, in URDF's order."""
        data = self.model.createData()
        Y = pinocchio.computeJointTorqueRegressor(
            self.model, data, *self._state(q, qd, qdd)
        ).reshape(self.model.nv, -1, 10)
        ids = {link: self.model.getJointId(name) for name, (link, *_) in self.moving.items()}
        Y = Y[:, [ids[link] - 1 for link in links]][:, :, URDF_ORDER]
        return self._gears().T @ Y.reshape(self.model.nv, -1)

    def _gears(self):
        gears = np.zeros((self.model.nv, self.chain.dof))
        for name, (_, column, scale, _) in self.moving.items():
            gears[self.model.joints[self.model.getJointId(name)].idx_v, column] = scale
        return gears

    def _state(self, q, qd, qdd):
        posture, gears = np.zeros(self.model.nq), self._gears()
        for name, (_, column, scale, shift) in self.moving.items():
            posture[self.model.joints[self.model.getJointId(name)].idx_q] = (
                scale * q[column] + shift
            )
        return posture, gears @ qd, gears @ qdd


@cache
def arm_oracle(name):
    """Return an arm of the catalogue as Pinocchio reads its URDF."""
    model = ikservo.load_model(name)
    # A joint may have the name of a link, by which Pinocchio cannot lock it.
    text = (CONFIGS / name / "arm.urdf").read_text()
    text = text.replace('joint name="', 'joint name="j:').replace(
        'mimic joint="', 'mimic joint="j:'
    )
    full = pinocchio.buildModelFromXML(text)
    beside = [each for each in list(full.names)[1:] if each[2:] not in model.chain.names]
    resting = pinocchio.neutral(full)
    for each in beside:
        column = full.joints[full.getJointId(each)].idx_q
        low, high = full.lowerPositionLimit[column], full.upperPositionLimit[column]
        resting[column] = min(max(0.0, low), high)
    reduced = pinocchio.buildReducedModel(full, [full.getJointId(each) for each in beside], resting)
    columns = {each: i for i, each in enumerate(model.chain.names)}
    moving = {
        f"j:{each.name}": (each.child, columns[each.name], 1.0, 0.0)
        for each in model.urdf.joints
        if each.name in columns
    }
    tip = reduced.frames[reduced.getFrameId(model.chain.tip)]
    place = tip.parentJoint, tip.placement
    return Oracle(model.chain, link_masses(model, model.chain), reduced, moving, place)


def made_oracle(joints, base, tip, moving, held=(), masses=None):
    """Return a chain of hand-written joints, branch after branch as Pinocchio requires.

    ``held`` are the values of joints that q does not move.
    """
    model, places, held = pinocchio.Model(), {base: (0, pinocchio.SE3.Identity())}, dict(held)
    for each in joints:
        parent, place = places[each.parent]
        place = place * pinocchio.SE3(each.origin)
        if each.name in moving:
            kinds = {
                JointType.REVOLUTE: pinocchio.JointModelRevoluteUnaligned,
                JointType.PRISMATIC: pinocchio.JointModelPrismaticUnaligned,
            }
            parent = model.addJoint(
                parent, kinds[each.kind](*map(float, each.axis)), place, each.name
            )
            place = pinocchio.SE3.Identity()
        elif each.name in held:  # the test's own motion, of a revolute joint
            R = exp_so3(held[each.name] * each.axis)
            place = place * pinocchio.SE3(make_pose(np.zeros(3), R))
        places[each.child] = parent, place
    masses = random_masses(places) if masses is None else masses
    for mass in masses:
        body = pinocchio.Inertia(mass.mass_kg, mass.centre_m, mass.inertia_kg_m2)
        parent, place = places[mass.link]
        model.appendBodyToJoint(parent, body, place)
    return Oracle(Chain.from_joints(joints, base, tip), masses, model, moving, places[tip])


def random_masses(links):
    """Return the mass of each link, with the tensor of a solid of uneven shape."""
    random = np.random.default_rng(11)
    masses = []
    for link in links:
        A = random.normal(size=(3, 3))
        moments = A @ A.T
        tensor = 0.01 * (np.trace(moments) * np.eye(3) - moments)
        masses.append(LinkMass(link, random.uniform(0.1, 2.0), random.normal(size=3), tensor))
    return masses


def crane_oracle():
    moving = {
        "turn": ("column", 0, 1.0, 0.0),
        "slide": ("cart", 1, 1.0, 0.0),
        "hook": ("hook", 1, 0.5, 0.1),
    }
    joints = {each.name: each for each in crane_joints()}
    ordered = [joints[name] for name in ("turn", "slide", "hook", "brake")]
    return made_oracle(ordered, "base", "hook", moving, {"brake": 0.2})


def oblique_oracle():
    """Return a chain with oblique axes, a continuous joint, followers of followers and a branch."""
    unit = np.array([1.0, 2.0, -2.0]) / 3.0
    rotated = make_pose([0.1, -0.2, 0.3], exp_so3([0.3, -0.8, 0.5]))
    joints = [
        joint("spin", JointType.REVOLUTE, "base", "drum", (0, 0.1, 0.2), unit),
        joint("plate", JointType.FIXED, "drum", "plate"),
        joint("lift", JointType.REVOLUTE, "plate", "arm", (0.3, 0, 0), (0, 1, 0),
              lower=-1.0, upper=2.0),
        joint("back", JointType.REVOLUTE, "arm", "level", (0.2, 0, 0.1), (0, 1, 0),
              mimic=Mimic("lift", -1.0, 0.3)),
        joint("reach", JointType.PRISMATIC, "level", "fore", (0.1, 0, 0), unit,
              lower=-0.2, upper=0.3),
        joint("jaw", JointType.REVOLUTE, "fore", "jaw", (0, 0, 0.1), (1, 0, 0),
              lower=0.4, upper=1.5),
        joint("finger", JointType.REVOLUTE, "jaw", "finger", (0, 0, 0.1), (0, 0, 1),
              mimic=Mimic("jaw", -2.0, 0.1)),
        joint("end", JointType.FIXED, "fore", "tip"),
        joint("rod", JointType.PRISMATIC, "drum", "rod", (0, 0.1, 0), unit[::-1],
              mimic=Mimic("back", 0.2, 0.05)),
    ]  # fmt: skip
    joints[1], joints[7] = replace(joints[1], origin=rotated), replace(joints[7], origin=rotated)
    moving = {
        "spin": ("drum", 0, 1.0, 0.0),
        "lift": ("arm", 1, 1.0, 0.0),
        "back": ("level", 1, -1.0, 0.3),
        "rod": ("rod", 1, -0.2, 0.2 * 0.3 + 0.05),
        "reach": ("fore", 2, 1.0, 0.0),
    }
    return made_oracle(joints, "base", "tip", moving, {"jaw": 0.4, "finger": 0.1 - 2.0 * 0.4})


MADE = {"crane": crane_oracle, "oblique": oblique_oracle}
NAMES = [*ARMS, *MADE]


@cache
def oracle_of(name):
    """Return the oracle of an arm of the catalogue or of a chain defined here."""
    return MADE[name]() if name in MADE else arm_oracle(name)


WALL_M_S2 = (9.81 * math.sin(0.3), 9.81 * math.cos(0.3), 0.0)
