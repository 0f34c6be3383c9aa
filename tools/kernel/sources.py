"""The modules of the kernels: their constants and functions, and where imported names come from."""

from __future__ import annotations

import ast
import hashlib
import math
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["Module", "Number", "Sources", "TranslationError"]

Number = int | float


class TranslationError(Exception):
    """A kernel uses something that is not in the subset."""


@dataclass
class Module:
    """A source file: its constants and functions, and the modules that other names come from."""

    name: str
    path: Path
    constants: dict[str, Number] = field(default_factory=dict[str, Number])
    functions: dict[str, ast.FunctionDef] = field(default_factory=dict[str, ast.FunctionDef])
    origins: dict[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]])

    def refusal(self, node: ast.AST, what: str = "") -> TranslationError:
        """Return the error with the place of a node."""
        line = getattr(node, "lineno", 0)
        return TranslationError(f"{self.path}:{line}: {what or ast.unparse(node) + ': not known'}")


class Sources:
    """The modules that were read so far, below the folder that holds the package."""

    def __init__(self, root: Path) -> None:
        self._root, self.modules = root, dict[str, Module]()

    def load(self, name: str) -> Module:
        """Parse a module once; note its constants, functions and imports."""
        if name not in self.modules:
            module = self.modules[name] = Module(name, self._path(name))
            for node in ast.parse(module.path.read_text("utf-8")).body:
                if isinstance(node, ast.FunctionDef):
                    module.functions[node.name] = node
                elif isinstance(node, ast.ImportFrom):
                    for each in node.names:
                        module.origins[each.asname or each.name] = (node.module or "", each.name)
                elif isinstance(node, ast.Assign):
                    self._read_constants(module, node)
        return self.modules[name]

    def constant(self, module: Module, name: str) -> Number | None:
        """Return the value of a module's constant, maybe imported; None if it has none."""
        home, original = module.origins.get(name, ("", ""))
        if home and self._path(home).is_file():
            return self.constant(self.load(home), original)
        return module.constants.get(name)

    def home(self, module: Module, name: str, node: ast.AST) -> Module:
        """Return the module that defines a function under the same name."""
        home = module
        while name in home.origins and self._path(home.origins[name][0]).is_file():
            home = self.load(home.origins[name][0])
        if name not in home.functions:
            raise module.refusal(node, f"{name}() is not known")
        return home

    def digests(self) -> tuple[list[Path], str]:
        """Return the files that were read, and the digest of each, separated by spaces."""
        paths = sorted(module.path for module in self.modules.values())
        return paths, " ".join(hashlib.sha256(path.read_bytes()).hexdigest() for path in paths)

    def _path(self, name: str) -> Path:
        return self._root.joinpath(*name.split(".")).with_suffix(".py")

    def _read_constants(self, module: Module, node: ast.Assign) -> None:
        used = [each.id for each in ast.walk(node.value) if isinstance(each, ast.Name)]
        known: dict[str, object] = {name: self.constant(module, name) for name in used}
        known |= {"math": math, "__builtins__": {}}
        if None in known.values():
            return
        value = eval(compile(ast.Expression(node.value), str(module.path), "eval"), known)
        (target,) = node.targets
        several = isinstance(target, ast.Tuple)
        names, values = (target.elts, value) if several else ([target], [value])
        for each, number in zip(names, values, strict=True):
            if ast.unparse(each) in module.constants:
                raise module.refusal(node, f"{ast.unparse(each)} is assigned twice")
            if type(number) in (int, float):
                module.constants[ast.unparse(each)] = number
