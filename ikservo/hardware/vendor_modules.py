"""Import modules that several packages on PyPI provide under the same name.

The package that was installed last has overwritten the files of the others, and uninstalling it
leaves an incomplete module. Errors then come from somewhere inside that module.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from importlib.metadata import packages_distributions

from ikservo.errors import IkservoError
from ikservo.remedies import pip_command


@contextmanager
def importing_from(distribution: str, module: str) -> Generator[None]:
    """Report a module that cannot be imported as a damaged installation.

    Raises:
        IkservoError: An import in the block has failed.
    """
    try:
        yield
    except (ImportError, AttributeError) as error:  # AttributeError: a module of the same name
        found = {name.lower() for name in packages_distributions().get(module, [])}
        others = sorted(found - {distribution})
        remove = f"{pip_command('uninstall --yes')} {' '.join(others)} && " if others else ""
        raise IkservoError(
            f"The Python module {module} of {distribution} is damaged or was replaced"
            + (f" by {' and '.join(others)}." if others else f": {error}."),
            f"Repair it: {remove}{pip_command('install --force-reinstall')} {distribution}",
        ) from error
