"""Figures of the source tree: sizes, names, packages, inheritance; ``--check`` fails on drift.

    python tools/style_figures.py [--check]

The check fails on a class name that is defined twice in a package, on a class that inherits
through more than two classes of the project, and on a private word in a name of any kind, in tests
and tools, too: words that mean something else in robotics, control, serial protocols or the web,
or nothing at all. The words of ``tools/odd_words.txt`` may not occur in docstrings and strings.
The description of an argument or attribute may not begin with "Of", "What" or the like.
The name of a test has at most 60 characters.
The structure may not exceed the bounds of ``pyproject.toml`` (`structure.py`).
"""

from __future__ import annotations

import argparse
import ast
import re
import statistics
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import structure

ROOT = Path(__file__).parent.parent
TREES = {"ikservo": ROOT / "ikservo", "servosim": ROOT / "sim" / "servosim"}
BESIDE = {"tests": ROOT / "tests", "tools": ROOT / "tools"}
MAX_DEPTH = 2
MAX_TEST_NAME = 60
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
# Base classes that others inherit from: those of Python and pydantic, and of apps' motions.
_OUTSIDE = frozenset(
    {
        "OwnMotion",
        "Exception",
        "BaseModel",
        "StrictModel",
        "Enum",
        "IntEnum",
        "StrEnum",
        "Protocol",
        "TypedDict",
    }
)
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Definition:
    """A class or a function of the tree."""

    path: Path
    node: ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef

    @property
    def name(self) -> str:
        """The name without leading underscores."""
        return self.node.name.strip("_")

    @property
    def lines(self) -> int:
        """The number of lines of the body, without docstring and blank lines."""
        body = self.node.body
        if isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
            body = body[1:]
        taken = {line for part in body for line in range(part.lineno, (part.end_lineno or 0) + 1)}
        return len(taken)


@dataclass(frozen=True)
class Tree:
    """The parsed modules below one root."""

    name: str
    modules: dict[Path, ast.Module]

    @classmethod
    def read(cls, name: str) -> Tree:
        """Return a tree with all its modules parsed."""
        paths = sorted((TREES | BESIDE)[name].rglob("*.py"))
        return cls(name, {path: ast.parse(path.read_text("utf-8")) for path in paths})

    @property
    def classes(self) -> list[Definition]:
        """All classes."""
        return list(self._definitions((ast.ClassDef,)))

    @property
    def functions(self) -> list[Definition]:
        """All functions and methods except ``__dunder__`` ones."""
        found = self._definitions(_FUNCTIONS)
        return [each for each in found if not each.node.name.startswith("__")]

    @property
    def lengths(self) -> list[int]:
        """The number of lines of each module that is not an ``__init__``."""
        paths = [path for path in self.modules if path.name != "__init__.py"]
        return [len(path.read_text("utf-8").splitlines()) for path in paths]

    def _definitions(self, kinds: tuple[type[ast.AST], ...]) -> Iterator[Definition]:
        for path, module in self.modules.items():
            for node in ast.walk(module):
                if isinstance(node, kinds):
                    yield Definition(path, node)  # pyright: ignore[reportArgumentType]


def one_word_fraction(names: Sequence[str]) -> float:
    """Return the fraction of names that are a single word."""
    return sum(len(_WORD.findall(name)) <= 1 for name in names) / max(1, len(names))


def repeated_names(tree: Tree) -> dict[str, list[Path]]:
    """Return class names that are defined more than once, with their files."""
    places: dict[str, list[Path]] = defaultdict(list)
    for each in tree.classes:
        places[each.name].append(each.path)
    return {name: paths for name, paths in places.items() if len(paths) > 1}


def depths(tree: Tree) -> dict[str, int]:
    """Return the depth of inheritance of each class within the project, itself included."""
    bases = {each.name: _bases(each.node) for each in tree.classes}
    return {name: _depth(name, bases) for name in bases}


def _bases(node: ast.AST) -> list[str]:
    assert isinstance(node, ast.ClassDef)
    return [ast.unparse(base).split("[")[0].split(".")[-1].strip("_") for base in node.bases]


def _depth(name: str, bases: dict[str, list[str]]) -> int:
    own = [base for base in bases.get(name, []) if base in bases and not _is_outside(base, bases)]
    above = [_depth(base, bases) for base in own]
    return 1 + max(above, default=0)


def _is_outside(name: str, bases: dict[str, list[str]]) -> bool:
    """Return whether a class is an exception, an enum, a protocol or a schema."""
    if name in _OUTSIDE or name.endswith(("Error", "Exception")):
        return True
    return any(_is_outside(base, bases) for base in bases.get(name, []))


def too_deep(tree: Tree) -> list[str]:
    """Return classes that inherit through more than two, except exceptions, enums and schemas."""
    bases = {each.name: _bases(each.node) for each in tree.classes}
    found = depths(tree).items()
    return [name for name, depth in found if depth > MAX_DEPTH and not _is_outside(name, bases)]


def private_words(tree: Tree, forbidden: frozenset[str]) -> list[str]:
    """Return ``file: name`` of every name defined in the tree that contains a forbidden word."""
    found = {
        f"{path.relative_to(ROOT)}: {name}"
        for path, module in tree.modules.items()
        for node in ast.walk(module)
        for name in _given_names(node)
        if forbidden & {word.lower() for word in _WORD.findall(name)}
    }
    return sorted(found)


def _given_names(node: ast.AST) -> Iterator[str]:
    """Yield the names that a node defines: a definition, a parameter, a variable, an attribute."""
    if isinstance(node, (ast.ClassDef, *_FUNCTIONS)):
        yield node.name
    elif isinstance(node, ast.arg):
        yield node.arg
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        yield node.id
    elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
        yield node.attr


def odd_words(tree: Tree, words: frozenset[str]) -> list[str]:
    """Return ``file:line: word`` of each string, docstrings included, with one of the words."""
    pattern = re.compile(rf"\b({'|'.join(sorted(words))})\b", re.IGNORECASE)
    return [
        f"{path.relative_to(ROOT)}:{node.lineno}: {found[0]}"
        for path, module in tree.modules.items()
        for node in ast.walk(module)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        for found in pattern.finditer(node.value)
    ]


# A description begins with the noun that it describes, see the guide for contributors.
_VAGUE_BEGINNING = re.compile(
    r"^ +[\w, ]+: (?:Of|As|As of|By|By so|What|With which|In which|How|Where|Which)\b(?! [^ ]+\()",
    re.MULTILINE,
)


def vague_descriptions(tree: Tree) -> list[str]:
    """Return ``file: line`` of each argument or attribute whose description begins vaguely."""
    return [
        f"{path.relative_to(ROOT)}: {found[0].strip()}"
        for path, module in tree.modules.items()
        for node in ast.walk(module)
        if isinstance(node, (ast.Module, ast.ClassDef, *_FUNCTIONS))
        for found in _VAGUE_BEGINNING.finditer(ast.get_docstring(node, clean=False) or "")
    ]


def long_test_names(tree: Tree) -> list[str]:
    """Return the names of tests that are too long to be read in a list."""
    names = {each.node.name for each in tree.functions if each.node.name.startswith("test_")}
    return sorted(name for name in names if len(name) > MAX_TEST_NAME)


def return_fraction(tree: Tree) -> float:
    """Return the fraction of the functions' docstrings that begin with ``Return``."""
    texts = [text for each in tree.functions if (text := ast.get_docstring(each.node))]
    return sum(text.startswith("Return") for text in texts) / max(1, len(texts))


def single_use_helpers(tree: Tree) -> list[str]:
    """Return the private functions and methods that their module uses only once.

    Properties, overloads and functions that a decorator registers do not count.
    """
    found: list[str] = []
    for path, module in tree.modules.items():
        uses = Counter(_used_names(module))
        found += [
            f"{path.relative_to(ROOT)}: {node.name}"
            for node in ast.walk(module)
            if isinstance(node, _FUNCTIONS)
            and re.match(r"_[a-z]", node.name)
            and not node.decorator_list
            and uses[node.name] == 1
        ]
    return found


def _used_names(module: ast.Module) -> Iterator[str]:
    for node in ast.walk(module):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr


def figures(tree: Tree) -> list[tuple[str, str]]:
    """Return the rows of the table: names and figures."""
    lengths = tree.lengths
    bodies = [each.lines for each in tree.functions]
    packages = sum(path.name == "__init__.py" for path in tree.modules)
    lines = sum(len(path.read_text("utf-8").splitlines()) for path in tree.modules)
    helpers = 1000 * len(single_use_helpers(tree)) / lines
    return [
        ("lines", f"{lines}"),
        ("modules", f"{len(tree.modules)}"),
        ("packages", f"{packages}"),
        ("lines of a module: median, 90 %, most", _spread(lengths)),
        ("lines of a function: median, 90 %, most", _spread(bodies)),
        ("function names of one word", f"{one_word_fraction(_names(tree.functions)):.0%}"),
        ("class names of one word", f"{one_word_fraction(_names(tree.classes)):.0%}"),
        ("class names used twice", f"{len(repeated_names(tree))}"),
        ("depth of inheritance, most", f"{len(too_deep(tree))} over {MAX_DEPTH}"),
        ("private helpers used once, a thousand lines", f"{helpers:.1f}"),
        ("function docstrings that begin with Return", f"{return_fraction(tree):.0%}"),
    ]


def _names(definitions: Sequence[Definition]) -> list[str]:
    return [each.name for each in definitions]


def _spread(values: Sequence[int]) -> str:
    ordered = sorted(values)
    return f"{statistics.median(ordered):.0f}, {ordered[int(0.9 * len(ordered))]}, {ordered[-1]}"


def drift(tree: Tree) -> list[str]:
    """Return one line for each rule that a tree of the product violates."""
    twice = repeated_names(tree).items()
    return [
        *(f"class {name} is defined in {_listed(paths)}" for name, paths in twice),
        *(f"class {name} inherits through more than {MAX_DEPTH}" for name in too_deep(tree)),
        *(f"vague beginning in {place}" for place in vague_descriptions(tree)),
        *(f"odd word in {place}" for place in odd_words(tree, _words("odd_words.txt"))),
    ]


def _listed(paths: Sequence[Path]) -> str:
    return ", ".join(f"{path.relative_to(ROOT)}" for path, _ in Counter(paths).items())


def _words(name: str) -> frozenset[str]:
    """Return the words of a file in ``tools``, one per line, without comments."""
    lines = (ROOT / "tools" / name).read_text("utf-8").splitlines()
    return frozenset(word for line in lines if (word := line.partition("#")[0].strip()))


def main() -> int:
    """Print the figures, or the violations; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="fail on drift")
    parser.add_argument("--helpers", action="store_true", help="list the helpers used once")
    options = parser.parse_args()
    trees = [Tree.read(name) for name in TREES]
    beside = [Tree.read(name) for name in BESIDE]
    if options.check:
        forbidden = _words("private_words.txt")
        found = [line for tree in trees for line in drift(tree)]
        found += structure.exceeded(TREES["ikservo"])
        found += [f"long name of a test: {name}" for name in long_test_names(beside[0])]
        for tree in trees + beside:
            found += [f"private word in {place}" for place in private_words(tree, forbidden)]
        print(*found, sep="\n") if found else None
        return 1 if found else 0
    if options.helpers:
        print(*(line for tree in trees for line in single_use_helpers(tree)), sep="\n")
        return 0
    for tree in trees:
        print(tree.name, *(f"  {what:<46}{how_much}" for what, how_much in figures(tree)), sep="\n")
    for what, how_much in structure.figures(TREES["ikservo"]).items():
        print(f"  {what.replace('_', ' '):<46}{how_much}")
    for tree in beside:
        print(tree.name, f"  {'lines':<46}{sum(tree.lengths)}", sep="\n")
    print(
        "README.md",
        f"  {'words':<46}{len((ROOT / 'README.md').read_text('utf-8').split())}",
        sep="\n",
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
