"""The regions that the tip can reach, found in the background and kept."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from ikservo.kinematics import Chain
from ikservo.view.scene.reach import Reach, ShownPlane, find_reach

__all__ = ["Reaches"]

_KEPT = 64


class Reaches:
    """Finds one region at a time; whoever asks for another meanwhile asks again later.

    Args:
        chain: The arm inside its own limits.
    """

    def __init__(self, chain: Chain) -> None:
        self._chain = chain
        self._known: dict[tuple[str, float], Reach] = {}
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="ikservo reach")
        self._busy: tuple[tuple[str, float], Future[Reach]] | None = None

    def get(self, plane: ShownPlane, *, idle: bool = True) -> Reach | None:
        """Return the region in a plane, where it is known; if not, it soon is.

        Args:
            plane: Which.
            idle: Whether there is time to look for it now.
        """
        self._collect()
        found = self._known.get(plane.key)
        if found is None and self._busy is None and idle:
            self._busy = (plane.key, self._worker.submit(find_reach, self._chain, plane))
        return None if found is None else found.moved_to(plane)

    def close(self) -> None:
        """Leave the one that is being looked for."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    def _collect(self) -> None:
        if self._busy is None or not self._busy[1].done():
            return
        key, future = self._busy
        self._busy = None
        if len(self._known) >= _KEPT:
            self._known.pop(next(iter(self._known)))
        self._known[key] = future.result()
