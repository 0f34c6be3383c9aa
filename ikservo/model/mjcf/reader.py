"""An MJCF becomes links, joints and shapes, compiled by MuJoCo itself."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from typing import Any

import numpy as np

from ikservo.errors import FileFormatError, InputError
from ikservo.kinematics.se3 import Matrix, Vector, exp_so3, pose
from ikservo.model.mjcf.files import check_files
from ikservo.model.mjcf.shapes import shapes_of
from ikservo.model.mjcf.turning import place_of, rpy_of, turned
from ikservo.model.urdf.parts import JointKind, Mimic, Urdf, UrdfJoint, UrdfLink

__all__ = ["read_mjcf"]

_NO_INERTIA = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def read_mjcf(path: Path, folder: Path | None = None) -> Urdf:
    """Read bodies, hinges, slides, geoms and sites of an MJCF.

    Bodies and sites are links; a body with several joints has one more link for each. The files
    that it names are judged first: none outside the model's folder is opened.

    Args:
        path: The file.
        folder: Under which its files may lie; its own if None.

    Raises:
        FileFormatError: A file leads out of the folder, MuJoCo refuses the model, or it has a
            joint that no servo turns.
        InputError: The extra ``physics`` is not installed.
    """
    check_files(path, path.parent if folder is None else folder)
    mujoco = _mujoco(path)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, OSError) as error:
        why = " ".join(str(error).split())[:200]
        raise FileFormatError(path, "", f"MuJoCo refuses it: {why}", "an MJCF") from error
    return _Bodies(path, mujoco, model).urdf()


def _mujoco(path: Path) -> Any:  # noqa: ANN401  # no types
    try:
        return importlib.import_module("mujoco")
    except ImportError:
        raise InputError(
            f"{path} is an MJCF; reading it needs mujoco, which is not installed.",
            "Install it: pip install 'ikservo[physics]'",
        ) from None


class _Bodies:
    """Makes links and joints of the bodies of a compiled model, parents first."""

    def __init__(self, path: Path, mujoco: Any, model: Any) -> None:  # noqa: ANN401
        self._path, self._mujoco, self._model = path, mujoco, model
        self._links: list[UrdfLink] = []
        self._joints: list[UrdfJoint] = []
        # Where each body's link frame is in the body's own frame: at its last joint.
        self._shift_m: list[Vector] = []
        self._names: list[str] = []

    def urdf(self) -> Urdf:
        model = self._model
        for body in range(model.nbody):
            self._names.append(model.body(body).name or f"body_{body}")
            self._shift_m.append(self._add_joints(body) if body else np.zeros(3))
            self._add_link(body)
        for site in range(model.nsite):
            self._add_site(site)
        return Urdf("", tuple(self._links), tuple(self._joints), self._names[0])

    def _add_joints(self, body: int) -> Vector:
        """Add the joints of a body and return where its link's frame is in the body's."""
        model, parent = self._model, int(self._model.body_parentid[body])
        at = pose(-self._shift_m[parent]) @ pose(
            model.body_pos[body], turned(model.body_quat[body])
        )
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        above, shift_m = self._names[parent], np.zeros(3)
        for joint in range(first, first + count):
            anchor_m = np.array(model.jnt_pos[joint])
            last = joint == first + count - 1
            child = self._names[body] if last else f"{self._names[body]}_{joint - first + 1}"
            self._joints.append(self._moving(joint, above, child, at @ pose(anchor_m - shift_m)))
            if not last:
                self._links.append(_empty(child))
            above, at, shift_m = child, np.eye(4), anchor_m
        if not count:
            name = f"{self._names[body]}_mount"
            self._joints.append(_fixed(name, above, self._names[body], at))
        return shift_m

    def _moving(self, joint: int, parent: str, child: str, T: Matrix) -> UrdfJoint:
        model, kinds = self._model, self._mujoco.mjtJoint
        name = model.joint(joint).name or f"joint_{joint}"
        kind, axis = kinds(int(model.jnt_type[joint])), np.array(model.jnt_axis[joint])
        if kind not in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
            raise FileFormatError(
                self._path, f"joint {name}", "is free or a ball", "hinge or slide"
            )
        slides, limited = kind == kinds.mjJNT_SLIDE, bool(model.jnt_limited[joint])
        if slides and not limited:
            raise FileFormatError(self._path, f"joint {name}", "slides without a range", "a range")
        zero = float(model.qpos0[model.jnt_qposadr[joint]])
        T = T @ (pose(-zero * axis) if slides else pose(np.zeros(3), exp_so3(-zero * axis)))
        low, high = (float(x) for x in model.jnt_range[joint]) if limited else (-math.inf, math.inf)
        turning = JointKind.REVOLUTE if limited else JointKind.CONTINUOUS
        return UrdfJoint(
            name=name,
            kind=JointKind.PRISMATIC if slides else turning,
            parent=parent,
            child=child,
            xyz_m=place_of(T),
            rpy_rad=rpy_of(T),
            axis=(float(axis[0]), float(axis[1]), float(axis[2])),
            lower=low,
            upper=high,
            effort=math.inf,
            velocity=math.inf,
            mimic=self._mimic(joint),
            line=0,
        )

    def _mimic(self, joint: int) -> Mimic | None:
        """Return the joint that an equality makes this one follow, if any."""
        model, kinds = self._model, self._mujoco.mjtEq
        for i in range(model.neq):
            ties_joints = kinds(int(model.eq_type[i])) == kinds.mjEQ_JOINT
            led = ties_joints and model.eq_active0[i] and model.eq_obj1id[i] == joint
            if led and int(model.eq_obj2id[i]) >= 0:
                leader = int(model.eq_obj2id[i])
                zero, zero_leader = (
                    float(model.qpos0[model.jnt_qposadr[j]]) for j in (joint, leader)
                )
                offset, slope = (float(x) for x in model.eq_data[i][:2])
                name = model.joint(leader).name or f"joint_{leader}"
                return Mimic(name, slope, zero + offset - slope * zero_leader)
        return None

    def _add_link(self, body: int) -> None:
        model, shift_m = self._model, self._shift_m[body]
        collide, drawn = shapes_of(self._mujoco, model, body, shift_m)
        com = pose(model.body_ipos[body] - shift_m, turned(model.body_iquat[body]))
        ixx, iyy, izz = (float(x) for x in model.body_inertia[body])
        self._links.append(
            UrdfLink(
                name=self._names[body],
                mass_kg=float(model.body_mass[body]) if body else 0.0,
                com_m=place_of(com),
                inertia_rpy_rad=rpy_of(com),
                inertia_kg_m2=(ixx, 0.0, 0.0, iyy, 0.0, izz),
                collisions=tuple(collide),
                visuals=tuple(drawn),
                line=0,
            )
        )

    def _add_site(self, site: int) -> None:
        model, body = self._model, int(self._model.site_bodyid[site])
        name = model.site(site).name or f"site_{site}"
        if name in {link.name for link in self._links}:
            name = f"{name}_site"
        T = pose(model.site_pos[site] - self._shift_m[body], turned(model.site_quat[site]))
        self._links.append(_empty(name))
        self._joints.append(_fixed(f"{name}_mount", self._names[body], name, T))


def _empty(name: str) -> UrdfLink:
    zero = (0.0, 0.0, 0.0)
    return UrdfLink(name, 0.0, zero, zero, _NO_INERTIA, (), (), 0)


def _fixed(name: str, parent: str, child: str, T: Matrix) -> UrdfJoint:
    return UrdfJoint(
        name=name,
        kind=JointKind.FIXED,
        parent=parent,
        child=child,
        xyz_m=place_of(T),
        rpy_rad=rpy_of(T),
        axis=(1.0, 0.0, 0.0),
        lower=0.0,
        upper=0.0,
        effort=math.inf,
        velocity=math.inf,
        mimic=None,
        line=0,
    )
