"""A mutant in place of its original: the code of one function, or a module imported again."""

from __future__ import annotations

import ast
import gc
import importlib.abc
import importlib.util
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

from mutation.mutant import Mutant

__all__ = [
    "Name",
    "NotLoadedError",
    "constants_around",
    "function_around",
    "functions_of",
    "import_anew",
    "put_constants_in",
    "put_in",
]

Name = tuple[str, int]
"""What a function is called in its module, and its first line."""


class NotLoadedError(Exception):
    """The function whose code is to be swapped is not loaded."""


Function = ast.FunctionDef | ast.AsyncFunctionDef


def function_around(mutant: Mutant) -> tuple[int, int] | None:
    """Return first and last line of the outermost function whose body has the change."""
    for node in _outermost(mutant.tree):
        last = node.end_lineno or node.lineno
        if node.body[0].lineno <= mutant.line <= last:
            return min([node.lineno, *(d.lineno for d in node.decorator_list)]), last
    return None


def _outermost(node: ast.AST) -> Iterator[Function]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, Function):
            yield child
        else:
            yield from _outermost(child)


def functions_of(path: Path) -> dict[Name, list[FunctionType]]:
    """Return the functions of a file that are loaded, by name and first line."""
    found: dict[Name, list[FunctionType]] = {}
    gc.unfreeze()  # the suite hides from the collector what it has imported
    for each in gc.get_objects():
        if isinstance(each, FunctionType) and each.__code__.co_filename == str(path):
            name = each.__code__.co_qualname, each.__code__.co_firstlineno
            found.setdefault(name, []).append(each)
    gc.freeze()
    return found


def put_in(mutant: Mutant, functions: Mapping[Name, Sequence[FunctionType]]) -> None:
    """Give the function that is changed, and is loaded already, the mutant's code.

    Raises:
        NotLoadedError: It is not among them.
    """
    first = (function_around(mutant) or (0, 0))[0]
    swapped = 0
    for code in _codes(compile(mutant.tree, str(mutant.path), "exec")):
        if code.co_firstlineno == first:
            for function in functions.get((code.co_qualname, first), ()):
                function.__code__ = code
                swapped += 1
    if not swapped:
        raise NotLoadedError


def constants_around(mutant: Mutant) -> list[str]:
    """Return the names that the changed statement of the module gives values; maybe none."""
    for node in mutant.tree.body:
        inside = node.lineno <= mutant.line <= (node.end_lineno or node.lineno)
        if inside and isinstance(node, ast.Assign):
            targets = (each for target in node.targets for each in ast.walk(target))
            return [each.id for each in targets if isinstance(each, ast.Name)]
    return []


def put_constants_in(mutant: Mutant) -> None:
    """Give constants of a module the mutant's values, in every module that has imported them."""
    changed: dict[str, object] = {"__name__": mutant.dotted}
    exec(compile(mutant.tree, str(mutant.path), "exec"), changed)
    original = sys.modules[mutant.dotted]
    for name in constants_around(mutant):
        old = getattr(original, name)
        for module in list(sys.modules.values()):
            if module.__name__.startswith("ikservo.") and vars(module).get(name) is old:
                setattr(module, name, changed[name])


def _codes(code: CodeType) -> Iterator[CodeType]:
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield each
            yield from _codes(each)


def import_anew(mutant: Mutant) -> None:
    """Import all our modules again, with the mutant in place of its module."""
    if mutant.package.is_plain(mutant.module):
        os.environ["IKSERVO_COMPILED"] = "0"
    for name in list(sys.modules):
        if name.split(".")[0] in ("ikservo", "servosim", "tests"):
            del sys.modules[name]
    sys.meta_path.insert(0, _Swap(mutant))


class _Swap(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports a mutant in place of its module."""

    def __init__(self, mutant: Mutant) -> None:
        self._mutant = mutant

    def find_spec(
        self, fullname: str, path: object = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find the mutated module only."""
        if fullname != self._mutant.dotted:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=str(self._mutant.path))

    def exec_module(self, module: ModuleType) -> None:
        """Run the mutant's code as the module's."""
        code = compile(self._mutant.tree, str(self._mutant.path), "exec")
        exec(code, module.__dict__)
