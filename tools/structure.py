"""Figures of the structure: modules that opening an arm imports, sizes of folders, repeated names.

The bounds are in ``pyproject.toml`` (``[tool.ikservo.structure]``); `style_figures.py --check`
fails if the tree exceeds them.
"""

from __future__ import annotations

import ast
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

OPENING = "ikservo.arm.opening"


def modules_of(package: Path) -> dict[str, Path]:
    """Return the modules of a package by their dotted names."""
    found: dict[str, Path] = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def closure(modules: Mapping[str, Path], start: str) -> list[str]:
    """Return the modules that importing ``start`` imports; imports inside functions do not count.

    Importing a module imports the packages that it is in.
    """
    seen: set[str] = set()
    waiting = [start]
    while waiting:
        module = waiting.pop()
        if module in seen or module not in modules:
            continue
        seen.add(module)
        waiting.append(module.rpartition(".")[0])
        waiting += _imports(ast.parse(modules[module].read_text("utf-8")), modules)
    return sorted(seen)


def _imports(node: ast.AST, modules: Mapping[str, Path]) -> Iterator[str]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        if isinstance(child, ast.Import):
            yield from (each.name for each in child.names)
        elif isinstance(child, ast.ImportFrom):
            package = child.module or ""
            for each in child.names:
                inner = f"{package}.{each.name}"
                yield inner if inner in modules else package
        yield from _imports(child, modules)


def folder_sizes(package: Path) -> Counter[Path]:
    """Return the number of modules in each folder, without its ``__init__.py``."""
    return Counter(path.parent for path in package.rglob("*.py") if path.name != "__init__.py")


def repeated_file_names(package: Path) -> dict[str, list[Path]]:
    """Return the names that several files of the package have, with these files."""
    places: dict[str, list[Path]] = defaultdict(list)
    for path in sorted(package.rglob("*.py")):
        if path.name != "__init__.py":
            places[path.name].append(path.relative_to(package))
    return {name: paths for name, paths in places.items() if len(paths) > 1}


def figures(package: Path) -> dict[str, int]:
    """Return the figures that ``pyproject.toml`` bounds, by the names that they have there."""
    modules = modules_of(package)
    opened = closure(modules, OPENING)
    repeated = repeated_file_names(package)
    return {
        "modules_to_open_an_arm": len(opened),
        "lines_to_open_an_arm": sum(_lines(modules[name]) for name in opened),
        "modules_in_a_folder": max(folder_sizes(package).values()),
        "repeated_file_names": len(repeated),
        "uses_of_a_file_name": max((len(paths) for paths in repeated.values()), default=1),
        "lines_of_the_package": sum(map(_lines, [*modules.values(), *_page_scripts(package)])),
    }


def _page_scripts(package: Path) -> list[Path]:
    """Return the scripts of the web page that are written here, not those of libraries."""
    return [path for path in package.rglob("*.js") if ".min." not in path.name]


def _lines(path: Path) -> int:
    return len(path.read_text("utf-8").splitlines())


def exceeded(package: Path) -> list[str]:
    """Return one line for each figure that exceeds its bound."""
    project = tomllib.loads((package.parent / "pyproject.toml").read_text("utf-8"))
    bounds: Mapping[str, int] = project["tool"]["ikservo"]["structure"]
    found = figures(package)
    return [
        f"{name}: {found[name]}, at most {bound} ([tool.ikservo.structure] in pyproject.toml)"
        for name, bound in bounds.items()
        if found[name] > bound
    ]
