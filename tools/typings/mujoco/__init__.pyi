# What servosim uses of MuJoCo; the wheel ships no types.
from collections.abc import Sequence
from enum import Enum

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int32]
_Vector = Sequence[float] | _Floats

class mjtGeom(Enum):
    mjGEOM_PLANE = ...
    mjGEOM_BOX = ...
    mjGEOM_CAPSULE = ...

class mjtJoint(Enum):
    mjJNT_HINGE = ...

class mjtEq(Enum):
    mjEQ_TENDON = ...

class mjtObj(Enum):
    mjOBJ_TENDON = ...

class mjtLimited(Enum):
    mjLIMITED_FALSE = ...

class mjtIntegrator(Enum):
    mjINT_IMPLICITFAST = ...

class mjtCone(Enum):
    mjCONE_ELLIPTIC = ...

class mjtTexture(Enum):
    mjTEXTURE_2D = ...
    mjTEXTURE_SKYBOX = ...

class mjtTextureRole(Enum):
    mjTEXROLE_RGB = ...

class mjtBuiltin(Enum):
    mjBUILTIN_CHECKER = ...
    mjBUILTIN_GRADIENT = ...

class mjtCamera(Enum):
    mjCAMERA_FIXED = ...

class mjtCatBit(Enum):
    mjCAT_ALL = ...

class mjtDepthMap(Enum):
    mjDEPTH_ZEROFAR = ...

class mjtFontScale(Enum):
    mjFONTSCALE_100 = ...

class mjtFramebuffer(Enum):
    mjFB_OFFSCREEN = ...

class _Joint:
    id: int

class _Body:
    id: int
    mocapid: _Ints

class _Option:
    timestep: float
    integrator: mjtIntegrator
    cone: mjtCone
    impratio: float
    noslip_iterations: int

class MjModel:
    jnt_dofadr: _Ints
    jnt_qposadr: _Ints
    jnt_range: _Floats
    dof_armature: _Floats
    dof_damping: _Floats
    dof_frictionloss: _Floats
    dof_solimp: _Floats
    body_dofadr: _Ints
    tendon_range: _Floats
    opt: _Option
    def body(self, name: str) -> _Body: ...
    def camera(self, name: str) -> _Joint: ...
    def joint(self, name: str) -> _Joint: ...
    def tendon(self, name: str) -> _Joint: ...

class MjData:
    qpos: _Floats
    qvel: _Floats
    qfrc_applied: _Floats
    qfrc_bias: _Floats
    ncon: int
    xpos: _Floats
    xmat: _Floats
    mocap_pos: _Floats
    mocap_quat: _Floats
    def __init__(self, model: MjModel) -> None: ...

class _Compiler:
    discardvisual: bool
    balanceinertia: bool

class MjsTendon:
    name: str
    solref_limit: tuple[float, ...]
    solimp_limit: _Floats
    def wrap_joint(self, joint: str, coef: float) -> object: ...

class MjsEquality:
    active: bool
    data: _Floats
    solref: tuple[float, ...]
    solimp: _Floats

class MjsJoint:
    name: str
    limited: mjtLimited

class MjsBody:
    name: str
    geoms: list[MjsGeom]
    explicitinertial: bool
    bodies: list[MjsBody]
    joints: list[MjsJoint]
    def add_geom(
        self,
        *,
        type: mjtGeom,
        size: _Vector,
        pos: _Vector = ...,
        quat: _Vector = ...,
        fromto: _Vector = ...,
        mass: float = ...,
        friction: _Vector = ...,
        condim: int = ...,
        rgba: _Vector = ...,
        material: str = ...,
        group: int = ...,
    ) -> object: ...
    def add_body(
        self,
        *,
        name: str,
        pos: _Vector = ...,
        mass: float = ...,
        inertia: tuple[float, ...] = ...,
        mocap: bool = ...,
    ) -> MjsBody: ...
    def add_freejoint(self, *, name: str) -> object: ...
    def add_camera(self, *, name: str, pos: _Vector, quat: _Vector, fovy: float) -> object: ...
    def add_light(
        self, *, pos: _Vector, dir: _Vector, diffuse: _Vector, specular: _Vector, castshadow: bool
    ) -> object: ...
    def add_joint(self, *, name: str, type: mjtJoint, axis: tuple[float, ...]) -> object: ...

class MjsGeom:
    group: int
    solimp: _Floats
    solmix: float
    rgba: _Vector

class MjsMaterial:
    textures: dict[mjtTextureRole, str]

class _Lighting:
    ambient: _Vector
    diffuse: _Vector
    specular: _Vector

class _Picture:
    offwidth: int
    offheight: int

class _Planes:
    znear: float
    zfar: float

class _Visual:
    global_: _Picture
    headlight: _Lighting
    map: _Planes

class _Size:
    extent: float

class MjSpec:
    compiler: _Compiler
    visual: _Visual
    stat: _Size
    geoms: list[MjsGeom]
    bodies: list[MjsBody]
    equalities: list[MjsEquality]
    option: _Option
    worldbody: MjsBody
    @staticmethod
    def from_file(filename: str) -> MjSpec: ...
    def add_texture(
        self,
        *,
        name: str,
        type: mjtTexture,
        builtin: mjtBuiltin,
        rgb1: _Vector,
        rgb2: _Vector,
        width: int,
        height: int,
    ) -> object: ...
    def add_material(
        self, *, name: str, texrepeat: _Vector, texuniform: bool, specular: float
    ) -> MjsMaterial: ...
    def add_exclude(self, *, bodyname1: str, bodyname2: str) -> object: ...
    def add_tendon(
        self, *, name: str, limited: bool = ..., range: tuple[float, ...] = ...
    ) -> MjsTendon: ...
    def add_equality(self, *, type: mjtEq, objtype: mjtObj, name1: str) -> MjsEquality: ...
    def compile(self) -> MjModel: ...

class GLContext:
    def __init__(self, max_width: int, max_height: int) -> None: ...
    def make_current(self) -> None: ...
    def free(self) -> None: ...

class MjrContext:
    readDepthMap: mjtDepthMap
    def __init__(self, model: MjModel, fontscale: object) -> None: ...

class MjrRect:
    width: int
    height: int
    def __init__(self, left: int, bottom: int, width: int, height: int) -> None: ...

class MjvScene:
    def __init__(self, model: MjModel, maxgeom: int) -> None: ...

class MjvOption: ...
class MjvPerturb: ...

class MjvCamera:
    type: mjtCamera
    fixedcamid: int

def mj_camlight(m: MjModel, d: MjData) -> None: ...
def mj_comPos(m: MjModel, d: MjData) -> None: ...
def mj_kinematics(m: MjModel, d: MjData) -> None: ...
def mjr_readPixels(
    rgb: NDArray[np.uint8], depth: NDArray[np.float32], viewport: MjrRect, con: MjrContext
) -> None: ...
def mjr_render(viewport: MjrRect, scn: MjvScene, con: MjrContext) -> None: ...
def mjr_setBuffer(framebuffer: object, con: MjrContext) -> None: ...
def mju_mat2Quat(quat: _Floats, mat: _Floats) -> None: ...
def mjv_updateScene(
    m: MjModel,
    d: MjData,
    opt: MjvOption,
    pert: MjvPerturb,
    cam: MjvCamera,
    catmask: object,
    scn: MjvScene,
) -> None: ...
def mj_forward(m: MjModel, d: MjData) -> None: ...
def mj_setConst(m: MjModel, d: MjData) -> None: ...
def mj_step(m: MjModel, d: MjData) -> None: ...
