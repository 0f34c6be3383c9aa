"""Old public names: each works for one version more, and warns."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

__all__ = ["current_name"]


def current_name(owner: str, renamed: Mapping[str, str], name: str) -> str:
    """Return what an old name of a module or class is called today, and warn whoever used it.

    To be called from a ``__getattr__``, whose caller the warning then names.

    Args:
        owner: The module or class, as a reader writes it.
        renamed: Today's names by the old ones.
        name: What was asked for.

    Raises:
        AttributeError: It is no old name either.
    """
    if name not in renamed:
        raise AttributeError(f"{owner} has no attribute {name!r}", name=name)
    words = f"{owner}.{name} is deprecated: use {owner}.{renamed[name]}."
    warnings.warn(words, DeprecationWarning, stacklevel=3)
    return renamed[name]
