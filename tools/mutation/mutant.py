"""One mutant: a module with one small change."""

from __future__ import annotations

import ast
import difflib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mutation.changes import changed_trees
from mutation.excused import EXCUSED
from mutation.packages import ROOT, Package

__all__ = ["Mutant", "mutants_of", "unchanged"]

_NUMBERS = re.compile(r"[-+.0-9e]+ -> [-+.0-9e]+")


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change of one module.

    Attributes:
        package: The package.
        module: The module's name below it.
        line: Where the change is.
        what: Description of the change.
        tree: The changed module.
    """

    package: Package
    module: str
    line: int
    what: str
    tree: ast.Module

    @property
    def dotted(self) -> str:
        """Return the name that the module is imported by."""
        return f"ikservo.{self.package.name}.{self.module}"

    @property
    def path(self) -> Path:
        """Return the file of the original."""
        return self.package.path_of(self.module)

    def excuse(self) -> str:
        """Return why the mutant is equivalent; empty if it is not."""
        line = self.path.read_text().splitlines()[self.line - 1].strip()
        place = f"{self.package.name}.{self.module}", line
        exact = EXCUSED.get((*place, self.what), "")
        return exact or (EXCUSED.get((*place, "number"), "") if self._is_number else "")

    @property
    def _is_number(self) -> bool:
        return bool(_NUMBERS.fullmatch(self.what))

    def __str__(self) -> str:
        """Return place, change and the changed lines."""
        before = ast.unparse(ast.parse(self.path.read_text())).splitlines()
        after = ast.unparse(self.tree).splitlines()
        lines = difflib.unified_diff(before, after, n=0, lineterm="")
        changed = "\n".join(line for line in lines if not line.startswith(("---", "+++", "@@")))
        return f"{self.path.relative_to(ROOT)}:{self.line}: {self.what}\n{changed}\n"


def mutants_of(package: Package, module: str) -> Iterator[Mutant]:
    """Yield every mutant of a module."""
    for line, what, tree in changed_trees(package.path_of(module).read_text()):
        yield Mutant(package, module, line, what, tree)


def unchanged(package: Package, module: str) -> Mutant:
    """Return a module as it is, in the form of a mutant."""
    tree = ast.parse(package.path_of(module).read_text())
    return Mutant(package, module, 1, "unchanged", tree)
