"""The collision checker: links, table and keep-out boxes along a path, with sag."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ikservo.errors import CollisionError
from ikservo.guard.path_sampling import refine_path
from ikservo.guard.sag import GravitySag, Sag
from ikservo.kinematics.arrays import Matrix, Vector, finite_vectors
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.kinematics.packed import LINK, RADIUS, SHAPE_WIDTH
from ikservo.model.arm_model import Obstacle

if TYPE_CHECKING:
    from ikservo.guard.clear_space import ClearSpace, RigidBodies

_TOUCH_M = 1e-9  # rounding of a distance of zero
# Between two samples, a distance may decrease unnoticed by this much; deeper contact is found.
_MAX_UNCHECKED_M = 0.001
# Searches check only samples. At samples, a required distance is increased by this fraction of its
# excess over a length, so that the motions between samples keep the distance, too.
_FURTHER = 0.2  # the fraction
_ABOVE_M = 0.001  # the length
# A contact at the start may get this much deeper on the path, for example if an arm on its table
# turns a joint.
_DEEPER_M = 5e-4
_DEEPER_AT_END_M = 1e-6  # a smaller value at the end, because many short motions would add up


class CollisionChecker:
    """Checker of postures and paths for collisions.

    Args:
        body: The arm's capsules; if its vectors end with the gripper's joint, the jaws are
            checked at their position.
        floor_m: Height of the table in the base frame; None if there is no table.
        boxes: Obstacles other than the table.
        sag: The sag of the joints from their goals in motion; paths are checked with and without
            sag. None if the arm does not yield.

    Attributes:
        pairs: The checked pairs: a link, and another link or the name of an obstacle.
        body: The packed body.
        shapes: The obstacles (k, 17) other than the table; see ``kinematics.packed``.
        floor_m: The height of the table; minus infinity if there is no table.
        things: The names of the obstacles other than the table.
        dof: The length of the joint vectors.
        overlap_m: The allowed overlap of each pair (pairs,).
        watched: Whether each pair (pairs,) is checked.
        bends: Computes the link joints (n, dof) from the sensor joints (n, dof); None if the arm
            does not bend between sensors and links.
    """

    def __init__(
        self,
        body: CollisionBody,
        floor_m: float | None = 0.0,
        boxes: Sequence[Obstacle] = (),
        sag: Sag | None = None,
    ) -> None:
        self.floor_m = -math.inf if floor_m is None else floor_m
        self.bends: Callable[[Matrix], Matrix] | None = None
        self.sag, self.body = sag, body.pack()
        packed = self.body
        self.dof = packed.dof
        self.things = tuple(box.name for box in boxes)
        self.shapes = np.array([box.row for box in boxes]).reshape(len(boxes), SHAPE_WIDTH)
        things = ["the table", *self.things]
        around = [(link, thing) for thing in things for link in packed.names]
        self.pairs = (*packed.pairs, *around)
        self.overlap_m = np.zeros(len(self.pairs))
        self.overlap_m[: len(packed.pairs)] = packed.overlap_m
        # The base link always touches the table.
        self.watched = np.array([link != packed.base for link, _ in self.pairs])
        self.watched[: len(packed.pairs)] = True
        self._pairs_with_sag = self.pairs
        reach_m = [packed.pair_reach_m, *[packed.reach_m] * len(things)]
        if sag is not None:
            self._pairs_with_sag = (*self.pairs, *around)
            reach_m += reach_m[1:]
        self._reach_m = np.vstack(reach_m)
        own, links = len(packed.pairs), len(packed.names)
        of_boxes = np.arange(len(self.pairs)) >= own + links
        sagged = of_boxes[own:] if sag is not None else of_boxes[:0]
        self._of_boxes = np.concatenate([of_boxes, sagged])

    def in_scene(
        self, body: CollisionBody, boxes: Sequence[Obstacle], sag: Sag | None
    ) -> CollisionChecker:
        """Return a checker of this arm with a different body and different obstacles."""
        other = CollisionChecker(body, self.floor_m, boxes, sag)
        other.bends = self.bends
        return other

    def check_path(
        self,
        path: Sequence[Vector] | Matrix,
        load: float = 1.0,
        *,
        may_touch_again: bool = False,
        rest: Vector | None = None,
        began_m: Vector | None = None,
    ) -> float:
        """Check a path of joint vectors (dof,) that starts at the present posture.

        An arm that touches the table or itself may move out of the contact. A pair in contact at
        the start may stay at that depth until it separates; afterwards it may overlap by at most
        0.5 mm. The same holds for a pair that is within 0.5 mm of contact at the start. A stream of
        goals checks two vectors: the present posture and the posture in which the arm would stop.
        Joints move on straight lines between the vectors; samples are closer where a contact is
        possible.

        Args:
            path: The joint vectors.
            load: Multiple of gravity that acts on the arm: more than 1 while it brakes.
            may_touch_again: Whether a pair in contact at the start may return to that depth and end
                there, as in a recording of an arm that was laid down; not for contact with a box.
            rest: The posture (dof,) at rest before the first vector. No contact may get deeper than
                in this posture, because the half millimetres of many checks would add up.
            began_m: Distances (pairs,) [m], negative, at which each contact began; -inf if unknown.
                A contact may get at most half a millimetre deeper than that over all motions.

        Returns:
            The smallest distance on the path [m], without sag.

        Raises:
            CollisionError: A pair would collide; the error names the first pair and its deepest
                contact.
            BadValueError: A joint is not finite.
        """
        fractions, gap_m = refine_path(
            finite_vectors(np.array(path), self.body.dof, "q"),
            lambda q: self.distances_with_sag(q, load),
            self._unresolved_intervals,
        )
        bodies, start_m = slice(len(self.pairs)), np.minimum(gap_m[0], 0.0)
        allowed_m = self._allowed_gaps(gap_m)
        if may_touch_again:
            at_start_m = start_m - self._deeper_m(gap_m[0])
            allowed_m = np.where(self._of_boxes, allowed_m, at_start_m)
        else:
            allowed_m[-1, bodies] = np.maximum(
                allowed_m[-1, bodies], start_m[bodies] - _DEEPER_AT_END_M
            )
        if rest is not None:
            rest_m = np.minimum(self.distances(rest[None])[0], 0.0)
            allowed_m[:, bodies] = np.maximum(
                allowed_m[:, bodies], np.minimum(rest_m - _DEEPER_M, gap_m[0, bodies])
            )
            allowed_m[-1, bodies] = np.maximum(allowed_m[-1, bodies], rest_m - _DEEPER_AT_END_M)
        if began_m is not None:
            most_m = np.minimum(began_m - _DEEPER_M, gap_m[0, bodies])
            allowed_m[:, bodies] = np.maximum(allowed_m[:, bodies], most_m)
        touching = ~(gap_m - allowed_m >= -_TOUCH_M)
        if touching.any():
            column = int(touching[touching.any(axis=1).argmax()].argmax())
            at = int(np.where(touching[:, column], gap_m[:, column], np.inf).argmin())
            raise CollisionError(
                self._pairs_with_sag[column], -float(gap_m[at, column]), float(fractions[at])
            )
        return float(gap_m[:, bodies].min())

    def collision_free(self, postures: Matrix) -> NDArray[np.bool_]:
        """Check which postures (n, dof) are free of collisions; return a mask (n,)."""
        return self._postures.contains(postures)

    @cached_property
    def _postures(self) -> ClearSpace:
        return self.clear_space(0.0, load=0.0)

    def clear_space(
        self, margin_m: float, ends: Matrix | None = None, load: float = 1.0
    ) -> ClearSpace:
        """Return the space of postures, and of motions between them, that keep a distance.

        Args:
            margin_m: The distance.
            ends: Postures (k, dof) to include if they touch nothing: pairs that are nearer than
                ``margin_m`` there may approach to half of their distance. Adjacent links are always
                near each other: keeping the whole distance would need very small steps.
            load: Multiple of gravity under which a yielding arm must also keep the distance; 0
                ignores sag.
        """
        nearest_m = np.full(len(self._pairs_with_sag), np.inf)
        if ends is not None:
            nearest_m = self.distances_with_sag(ends, load).min(axis=0, initial=np.inf)
        near_m = np.where(nearest_m < margin_m, 0.5 * np.maximum(nearest_m, 0.0), margin_m)
        sampled_m = near_m + _FURTHER * np.maximum(near_m - _ABOVE_M, 0.0)
        sampled_m = np.minimum(sampled_m, np.maximum(nearest_m, 0.0))
        allowed_m, sampled_m = (self._allowed_of_capsules(each) for each in (near_m, sampled_m))
        sag = self.sag if isinstance(self.sag, GravitySag) and load > 0.0 else None
        from ikservo.guard.clear_space import ClearSpace  # noqa: PLC0415  # few programs need it

        return ClearSpace(
            self.body, self._rigid, self.shapes, self.floor_m, allowed_m, sag, load, self.bends,
            sampled_m,
        )  # fmt: skip

    @cached_property
    def _rigid(self) -> RigidBodies:
        from ikservo.guard.clear_space import RigidBodies  # noqa: PLC0415

        return RigidBodies(self.body)

    def _allowed_of_capsules(self, near_m: Vector) -> Matrix:
        """Convert allowed distances of pairs to those of capsules (2, …); row 1 is for sag."""
        count = len(self.pairs)
        allowed_m = np.tile(near_m[:count] - self.overlap_m, (2, 1))
        if self.sag is not None:
            allowed_m[1, len(self.body.pairs) :] = near_m[count:]
        allowed_m[:, ~self.watched] = -np.inf
        return allowed_m

    def distances(self, path: Sequence[Vector] | Matrix) -> Matrix:
        """Compute the distance of each pair (n, pairs) [m] in postures (n, dof)."""
        from ikservo.kernels.capsule_distances import min_distances  # noqa: PLC0415

        body, q = self.body, finite_vectors(np.array(path), self.body.dof, "q")
        if self.bends is not None:
            q = self.bends(q)
        distances = np.full((len(q), len(self.pairs)), np.inf)
        places, ends = np.empty((len(body.links), 12)), np.empty((len(body.capsules), 6))
        min_distances(
            body.links,
            body.capsules,
            body.rows,
            self.floor_m,
            self.shapes,
            q,
            places,
            ends,
            distances,
        )
        distances += self.overlap_m
        distances[:, ~self.watched] = np.inf
        return distances

    def capsules_at(self, q: Vector) -> list[Capsule]:
        """Compute the capsules of the body in a posture (dof,), base frame."""
        from ikservo.kernels.capsule_distances import place_capsules, place_links  # noqa: PLC0415

        body = self.body
        posture = q if self.bends is None else self.bends(q[None])[0]
        places, ends = np.empty((len(body.links), 12)), np.empty((len(body.capsules), 6))
        place_links(body.links, posture, places)
        place_capsules(body.capsules, places, ends)
        return [
            Capsule(body.names[int(row[LINK])], end[:3], end[3:], float(row[RADIUS]))
            for row, end in zip(body.capsules, ends, strict=True)
        ]

    def _unresolved_intervals(self, path: Matrix, gap_m: Matrix) -> NDArray[np.intp]:
        """Find intervals of the path where a collision is possible; return their first samples."""
        nearer_m = np.abs(np.diff(path, axis=0)) @ self._reach_m.T
        slack_m = gap_m - self._allowed_gaps(gap_m)
        free = np.minimum(slack_m[:-1], slack_m[1:]) >= -_TOUCH_M
        may_touch = slack_m[:-1] + slack_m[1:] < nearer_m
        return np.flatnonzero((free & may_touch & (nearer_m > 2 * _MAX_UNCHECKED_M)).any(axis=1))

    def distances_with_sag(self, path: Matrix, load: float = 1.0) -> Matrix:
        """Compute the distances (n, pairs + sagging) [m] in postures (n, dof).

        First come the distances of every pair without sag, then the distances to the surroundings
        with sag. An arm that lies on the table sags only in this computation, so both are kept.
        """
        gap_m = self.distances(path)
        if self.sag is None:
            return gap_m
        sagged_m = self.distances(path + load * self.sag(path))
        return np.hstack([gap_m, sagged_m[:, len(self.body.pairs) :]])

    def _allowed_gaps(self, gap_m: Matrix) -> Matrix:
        """Compute the smallest allowed distances of ``distances_with_sag`` at each sample [m].

        A contact at the start is allowed until its pair is free for the first time.
        """
        been_free = np.logical_or.accumulate(gap_m >= -_TOUCH_M, axis=0)
        # While the arm leaves a contact, a pair that touches at the start, or nearly so, may graze
        # by less than the accuracy of the model.
        leaves = bool((gap_m[0] < -_TOUCH_M).any())
        again_m = np.where(leaves & (gap_m[0] < _DEEPER_M), -_DEEPER_M, 0.0)
        return np.where(been_free, again_m, np.minimum(gap_m[0], 0.0) - self._deeper_m(gap_m[0]))

    def _deeper_m(self, start_m: Vector) -> Vector:
        """Compute the overlap [m] allowed for each pair beyond its overlap at the start.

        If the arm touches only with sag, half of its distance without sag at the start is allowed.
        """
        deeper_m = np.full(len(start_m), _DEEPER_M)
        if self.sag is not None:
            surroundings = slice(len(self.body.pairs), len(self.pairs))
            sagged = slice(len(self.pairs), None)
            deeper_m[sagged] = np.maximum(_DEEPER_M, 0.5 * start_m[surroundings])
        return deeper_m
