"""Job that records an arm guided by hand, for a step of the page's program."""

from __future__ import annotations

import threading
from itertools import count
from pathlib import Path

from ikservo.apps.page.running.arm_job import JobObserver
from ikservo.arm import Arm
from ikservo.errors import InputError
from ikservo.files.writing import make_folder

SUFFIX = ".jsonl"
_SHOWN_EVERY = 5  # the page is updated every fifth sample, because reading takes bus time


class RecordArm:
    """Job that records joint positions until ``finish`` (``ArmJob``); torque stays unchanged.

    Args:
        folder: The folder for a new file with an unused name.

    Attributes:
        path: The file; None until it is complete.
    """

    title = "Recording"
    is_planned = False

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._finished = threading.Event()
        self.path: Path | None = None

    def finish(self) -> None:
        """End the recording; safe from any thread."""
        self._finished.set()

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Record the joint positions until ``finish`` is called.

        Raises:
            IkservoError: The arm was stopped, or a servo does not answer; the samples before it
                are kept.
        """
        if all(state.torque for state in arm.where().joints):
            observer.log_message(
                "The arm holds its position, so it cannot be guided. Press Relax or Release first."
            )
            return
        path, samples = self._free_path(), count(1)

        def is_finished() -> bool:
            if next(samples) % _SHOWN_EVERY == 0:
                observer.on_idle()
            return self._finished.is_set()

        arm.record(path, until=is_finished)
        self.path = path

    def _free_path(self) -> Path:
        make_folder(self._folder)
        for number in range(1, 10_000):
            path = self._folder / f"recording-{number}{SUFFIX}"
            if not path.exists():
                return path
        raise InputError(f"Folder {self._folder} is full of recordings.", "Remove some.")
