"""Slow analyses of a posture, computed in the background and cached."""

from __future__ import annotations

from collections.abc import Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.conditioning import Singularity, nearest_singularity
from ikservo.view.camera import Camera
from ikservo.view.visibility import LinkVisibility, VisibilityChecker

__all__ = ["PostureAnalyser", "PostureAnalysis"]

_SAME_RAD = 5e-3


@dataclass(frozen=True, slots=True, eq=False)
class PostureAnalysis:
    """What was found out about a posture as it is seen by somebody.

    Attributes:
        q: The joints (dof,).
        camera: What it was seen through, see ``Camera.fingerprint``.
        singularity: The nearest singular posture of the tip; None where none was found.
        seen: How much of each link is in sight.
    """

    q: Vector
    camera: Hashable
    singularity: Singularity | None
    seen: tuple[LinkVisibility, ...]


class PostureAnalyser:
    """Finds out one thing at a time; whoever asks for another meanwhile asks again later.

    Args:
        chain: The arm inside its own limits.
        visibility: Says what hides what.
    """

    def __init__(self, chain: Chain, visibility: VisibilityChecker) -> None:
        self._chain, self._visibility = chain, visibility
        self._known: dict[int, PostureAnalysis] = {}
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="ikservo insight")
        self._busy: tuple[int, Future[PostureAnalysis]] | None = None

    def get(
        self, who: int, q: Vector, poses: dict[str, Matrix], camera: Camera, *, idle: bool
    ) -> PostureAnalysis | None:
        """Return what is known of a posture (dof,) as it is now; if nothing, it soon is.

        Args:
            who: Whose camera it is.
            q: The joints (dof,).
            poses: T_world_link (4, 4) of every link there.
            camera: What they are seen through.
            idle: Whether there is time to find out now.
        """
        self._collect_result()
        known = self._known.get(who)
        if known is not None and _is_same_posture(known, q, camera):
            return known
        if idle and self._busy is None:
            self._busy = (who, self._worker.submit(self._analyse, q.copy(), poses, camera))
        return None

    def close(self) -> None:
        """Leave what is being found out."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    def _analyse(self, q: Vector, poses: dict[str, Matrix], camera: Camera) -> PostureAnalysis:
        seen = self._visibility.from_camera(poses, camera)
        return PostureAnalysis(q, camera.fingerprint, nearest_singularity(self._chain, q), seen)

    def _collect_result(self) -> None:
        if self._busy is None or not self._busy[1].done():
            return
        who, future = self._busy
        self._busy = None
        self._known[who] = future.result()


def _is_same_posture(known: PostureAnalysis, q: Vector, camera: Camera) -> bool:
    still = float(np.abs(known.q - q).max(initial=0.0)) < _SAME_RAD
    return still and known.camera == camera.fingerprint
