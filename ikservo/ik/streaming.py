"""The prepared solver: one question asked in a loop, without allocation on the way."""

from __future__ import annotations

from dataclasses import replace
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.ik.kernel.layout import FURTHEST_RAD, REACHED
from ikservo.ik.options import Options, Tolerance
from ikservo.ik.preparing import (
    BOTTOM,
    Kind,
    KindName,
    Worker,
    check_bottom,
    check_chain,
    check_options,
    kernel,
    kind_named,
    prepared,
    settings_of,
)
from ikservo.ik.reading import result_of
from ikservo.ik.result import Result
from ikservo.ik.side import Side
from ikservo.ik.target import near, unit
from ikservo.kinematics import Chain, finite_array, finite_vector
from ikservo.kinematics.se3 import Vector

__all__ = ["Solver"]


class Solver:
    """A question prepared once and asked in a loop; one object for each thread.

    Calling it is ``solve(…, nearest=False)``: it begins at ``q0`` and starts again elsewhere where
    that leads nowhere. Joints that do not move the point stay at ``q0``. ``track`` follows a path:
    it walks from ``q0`` only, never jumps to another branch, and where a limit blocks it goes as
    near as it can. A path that goes on from the last answer and stretched the arm straight comes
    back on the side that it went out by.

    Args:
        chain: The arm.
        kind: What of the wanted pose counts: its position, also the direction of the tool axis,
            or all of it.
        tool_axis: The axis (3,) in the frame's coordinates that "direction" speaks of.
        frame: The link that shall go there; the tip if None.
        offset_m: The point (3,) of that link, metres; its origin if None.
        tolerance: How close counts as reached.
        options: How hard to try and what comes first; has a tolerance of its own.

    Raises:
        BadValueError: An axis or offset makes no sense.
        UnknownNameError: No such kind or frame.
    """

    def __init__(
        self,
        chain: Chain,
        kind: KindName = "position",
        *,
        tool_axis: ArrayLike = (0.0, 0.0, 1.0),
        tolerance: Tolerance | None = None,
        frame: str | None = None,
        offset_m: ArrayLike | None = None,
        options: Options | None = None,
    ) -> None:
        check_chain(chain)
        options = options or Options(tolerance or Tolerance())
        check_options(options)
        self.chain, self.kind = chain, kind
        self._kind = kind_named(kind)
        self._axis = unit(tool_axis, "tool_axis")
        offset = None if offset_m is None else near(offset_m, "offset_m")
        axis = self._axis if self._kind is Kind.DIRECTION else None
        ready = prepared(chain, frame, offset, axis, options.restarts)
        self._arm, self._seeds = ready.arm, ready.seeds
        idle = ready.idle[self._kind]
        self._idle = tuple((each.column, each.lower, each.upper, each) for each in idle)
        self._settings = settings_of(self._kind, chain.dof, options)
        self._track = settings_of(self._kind, chain.dof, replace(options, track=True))
        self._search = kernel()
        self._worker = worker = Worker(chain.dof, options.restarts)
        self._rotation = worker.question[0, 3:].reshape(3, 3)
        self._shape = (chain.dof,)
        self._reached = 2 * chain.dof + REACHED
        self._side, self._asked = Side(chain.dof), False

    def __repr__(self) -> str:
        """Return what is asked of which chain."""
        return f"Solver(kind={self.kind!r}, {self.chain.dof} joints to {self.chain.tip!r})"

    def __call__(
        self, T_world_tool: ArrayLike, q0: ArrayLike, out: Vector | None = None
    ) -> tuple[Vector, bool]:
        """Return joints (dof,) for the pose (4, 4), near ``q0`` (dof,), and whether they reach.

        ``out`` (dof,) takes the joints, where given; without it an array is made.

        Raises:
            BadValueError: A shape is wrong, or a number that counts is not finite, too large or
                no part of a rotation.
        """
        return self._ask(self._settings, T_world_tool, q0, out)

    def track(
        self, T_world_tool: ArrayLike, q0: ArrayLike, out: Vector | None = None
    ) -> tuple[Vector, bool]:
        """Return the joints that ``q0`` leads to on its own branch, and whether they reach.

        Args and errors are those of a call; where a limit blocks, ``result`` names it.
        """
        q, reached = self._ask(self._track, T_world_tool, q0, out)
        if reached and self._side.left_at(q0):
            q, reached = self._ask(self._track, T_world_tool, self._side.start(), out)
            if not reached:
                q, reached = self._ask(self._track, T_world_tool, q0, out)
        self._side.note(q0, q, reached=reached)
        return q, reached

    @property
    def result(self) -> Result:
        """Return the whole answer to the last question: what is left, which limits bind.

        Raises:
            BadValueError: Nothing was asked yet.
        """
        if not self._asked:
            raise BadValueError("The last question", "none", "a call before its result")
        return result_of(self.chain, self._worker.answer[0], "bounded")

    def _ask(
        self, settings: Vector, T: ArrayLike, q0: ArrayLike, out: Vector | None
    ) -> tuple[Vector, bool]:
        worker = self._worker
        if out is not None:
            self._check_out(out)
        self._write(T, q0)
        if self._search(
            self._arm, worker.question, settings, worker.start, self._seeds, worker.desk,
            worker.trace, worker.answer,
        ) >= 0:  # fmt: skip
            self._refuse(T, q0)
        self._asked, answer = True, worker.answer[0]
        for column, lower, upper, joint in self._idle:
            start = worker.start.item(column)
            answer[column] = start if lower <= start <= upper else joint.stays_at(start)
        if out is None:
            return answer[: self.chain.dof].copy(), bool(answer[self._reached])
        out[:] = answer[: self.chain.dof]
        return out, bool(answer[self._reached])

    def _write(self, T: ArrayLike, q0: ArrayLike) -> None:
        try:
            pose, start = np.asarray(T, dtype=np.float64), np.asarray(q0, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            self._refuse(T, q0)
        if pose.shape != (4, 4) or start.shape != self._shape:
            self._refuse(T, q0)
        if pose[3].tolist() != BOTTOM:
            check_bottom(pose, "T_world_tool")
        question = self._worker.question[0]
        question[:3] = pose[:3, 3]
        if self._kind is Kind.POSE:
            self._rotation[:] = pose[:3, :3]
        elif self._kind is Kind.DIRECTION:
            self._rotation[:, 2] = pose[:3, :3] @ self._axis
        self._worker.start[0] = start

    def _refuse(self, T: ArrayLike, q0: ArrayLike) -> NoReturn:
        """Say what is wrong with a question that the kernel did not accept."""
        start = finite_vector(q0, self.chain.dof, "q0")
        if float(np.abs(start).max()) > FURTHEST_RAD:
            raise BadValueError("q0", start.tolist(), "radians and metres, at most 1e6")
        near(finite_array(T, (4, 4), "T_world_tool")[:3, 3], "The target position")
        raise BadValueError("The rotation of T_world_tool", "none", "R Rᵀ = 1 and det R = 1")

    def _check_out(self, out: Vector) -> None:
        """Raise BadValueError where the joints cannot be written as they are."""
        array = np.asarray(out)
        if array is not out or array.shape != self._shape or array.dtype != np.float64:
            raise BadValueError("out", f"{out!r}", f"an array of floats of shape {self._shape}")
