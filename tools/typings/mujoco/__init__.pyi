# What servosim uses of MuJoCo; the wheel ships no types.
from enum import Enum

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int32]

class mjtGeom(Enum):
    mjGEOM_PLANE = ...

class mjtJoint(Enum):
    mjJNT_HINGE = ...

class mjtIntegrator(Enum):
    mjINT_IMPLICITFAST = ...

class _Joint:
    id: int

class _Option:
    timestep: float
    integrator: mjtIntegrator

class MjModel:
    jnt_dofadr: _Ints
    jnt_qposadr: _Ints
    jnt_range: _Floats
    dof_armature: _Floats
    dof_damping: _Floats
    dof_frictionloss: _Floats
    dof_solimp: _Floats
    tendon_range: _Floats
    opt: _Option
    def joint(self, name: str) -> _Joint: ...
    def tendon(self, name: str) -> _Joint: ...

class MjData:
    qpos: _Floats
    qvel: _Floats
    qfrc_applied: _Floats
    qfrc_bias: _Floats
    ncon: int
    def __init__(self, model: MjModel) -> None: ...

class _Compiler:
    discardvisual: bool
    balanceinertia: bool

class MjsTendon:
    solref_limit: tuple[float, ...]
    solimp_limit: _Floats
    def wrap_joint(self, joint: str, coef: float) -> object: ...

class MjsBody:
    name: str
    explicitinertial: bool
    bodies: list[MjsBody]
    joints: list[object]
    def add_geom(
        self, *, type: mjtGeom, size: tuple[float, ...], pos: tuple[float, ...]
    ) -> object: ...
    def add_body(self, *, name: str, mass: float, inertia: tuple[float, ...]) -> MjsBody: ...
    def add_joint(self, *, name: str, type: mjtJoint, axis: tuple[float, ...]) -> object: ...

class MjSpec:
    compiler: _Compiler
    option: _Option
    worldbody: MjsBody
    @staticmethod
    def from_file(filename: str) -> MjSpec: ...
    def add_exclude(self, *, bodyname1: str, bodyname2: str) -> object: ...
    def add_tendon(self, *, name: str, limited: bool, range: tuple[float, ...]) -> MjsTendon: ...
    def compile(self) -> MjModel: ...

def mj_forward(m: MjModel, d: MjData) -> None: ...
def mj_setConst(m: MjModel, d: MjData) -> None: ...
def mj_step(m: MjModel, d: MjData) -> None: ...
