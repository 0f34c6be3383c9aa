"""A progress bar on a terminal's stderr, and nothing elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager

__all__ = ["Show", "bar"]

Show = Callable[[str, float, float], None]
"""Takes what is being done, how much of it is done, and how much there is."""


@contextmanager
def bar() -> Generator[Show | None]:
    """Yield what draws a progress bar, or None where nobody would see it."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import BarColumn, TextColumn  # noqa: PLC0415
    from rich.progress import Progress as Bar  # noqa: PLC0415

    columns = (BarColumn(), TextColumn("{task.description}"))
    with Bar(*columns, console=Console(stderr=True), transient=True) as drawn:
        task = drawn.add_task("", total=None)

        def show(what: str, done: float, total: float) -> None:
            drawn.update(task, description=what, completed=done, total=total)

        yield show
