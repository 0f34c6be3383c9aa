"""Old public names: each works for one version more, with a warning."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

__all__ = ["current_name"]


def current_name(owner: str, renamed: Mapping[str, str], name: str) -> str:
    """Return the present name of an old name of a module or class, with a warning.

    Call it from a ``__getattr__``, whose caller is then named in the warning.

    Args:
        owner: The module or class, as users write it.
        renamed: The present names by the old ones.
        name: The requested name.

    Raises:
        AttributeError: It is no old name either.
    """
    if name not in renamed:
        raise AttributeError(f"{owner} has no attribute {name!r}", name=name)
    message = f"{owner}.{name} is deprecated: use {owner}.{renamed[name]}."
    warnings.warn(message, DeprecationWarning, stacklevel=3)
    return renamed[name]
