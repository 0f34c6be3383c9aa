"""Mutation run over the guard: every small change of its code must make a test fail.

    python tools/mutate.py [MODULE ...] [--jobs N] [--list]

Each mutant is one change: a comparison, a sign, a constant, a condition, a statement left out. It
is imported in a forked process in place of the module, and ``tests/guard`` runs until a test
fails. Survivors are printed with their place and difference; the exit code is 1 if there are any.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import copy
import difflib
import importlib.abc
import importlib.util
import io
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[1]
GUARD = ROOT / "ikservo" / "guard"
TESTS = ROOT / "tests" / "guard"
TIMEOUT_S = 300.0
KERNEL = "nearness"

# Mutants that no test can tell from the original, each with the reason: (module, line as it
# stands in the file, what the mutant does) -> why it is the same.
_NO_ZERO = "only keeps a division from zero: any tiny number does"
_TIE = "if _box_at(ends, i, s, boxes, b) <= _box_at(ends, i, t, boxes, b):"
_ROOM = "memory may be wider than what is written to it"
_BUFFERS = "places, ends = np.empty((len(body.links), 12)), np.empty((len(body.capsules), 6))"
EXCUSED: dict[tuple[str, str, str], str] = {
    ("nearness", "_NOTHING = 1e-30", "1e-30 -> 1.2500000000000001e-30"): _NO_ZERO,
    ("nearness", "_NOTHING = 1e-30", "1e-30 -> 8e-31"): _NO_ZERO,
    ("nearness", "_SECTIONS = 40  # the rest of a segment of one metre is then 4 nm", "40 -> 41"): (
        "one section more makes a right answer finer"
    ),
    ("nearness", _TIE, "LtE -> Lt"): "of two equal ends of a convex valley either may be cut off",
    ("space", _BUFFERS, "12 -> 13"): _ROOM,
    ("space", _BUFFERS, "6 -> 7"): _ROOM,
}

_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),  # codespell:ignore notin
    ast.NotIn: (ast.In,),  # codespell:ignore notin
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}
_OPERATORS: dict[type[ast.operator], tuple[type[ast.operator], ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
}
_CALLS = {
    "min": "max", "max": "min", "floor": "ceil", "ceil": "floor", "any": "all", "all": "any",
    "sin": "cos", "cos": "sin", "minimum": "maximum", "maximum": "minimum", "argmin": "argmax",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change of one module.

    Attributes:
        module: The module's name below ``ikservo.guard``.
        line: Where the change is.
        what: The change in words.
        tree: The changed module.
    """

    module: str
    line: int
    what: str
    tree: ast.Module

    @property
    def path(self) -> Path:
        """Return the file of the original."""
        return GUARD / f"{self.module}.py"

    def excuse(self) -> str:
        """Return why no test can see this one; empty where one must."""
        line = self.path.read_text().splitlines()[self.line - 1].strip()
        return EXCUSED.get((self.module, line, self.what), "")

    def difference(self) -> str:
        """Return the changed lines."""
        before = ast.unparse(ast.parse(self.path.read_text())).splitlines()
        after = ast.unparse(self.tree).splitlines()
        lines = difflib.unified_diff(before, after, n=0, lineterm="")
        return "\n".join(line for line in lines if not line.startswith(("---", "+++", "@@")))


def mutants_of(module: str) -> Iterator[Mutant]:
    """Yield every mutant of a module of the guard."""
    source = (GUARD / f"{module}.py").read_text()
    for index, place in enumerate(_walk(ast.parse(source))):
        for k in range(len(_changes(place))):
            tree = ast.parse(source)
            node = _walk(tree)[index]
            what, change = _changes(node)[k]
            change()
            line = getattr(node.node, "lineno", 0)
            yield Mutant(module, line, what, ast.fix_missing_locations(tree))


@dataclass(frozen=True, slots=True)
class _Place:
    """A node, and how to put another in its place."""

    node: ast.AST
    replace: Callable[[ast.AST], None]
    is_code: bool


def _walk(tree: ast.Module) -> list[_Place]:
    places: list[_Place] = []
    _descend(tree, lambda _: None, True, places)
    return places


def _descend(
    node: ast.AST, replace: Callable[[ast.AST], None], is_code: bool, places: list[_Place]
) -> None:
    places.append(_Place(node, replace, is_code))
    for name, value in ast.iter_fields(node):
        inside = is_code and not _is_no_code(node, name)
        if isinstance(value, ast.AST):
            _descend(value, _setter(node, name), inside, places)
        elif isinstance(value, list):
            for i, item in enumerate(value):  # pyright: ignore[reportUnknownVariableType,reportUnknownArgumentType]
                if isinstance(item, ast.AST):
                    _descend(item, _item_setter(value, i), inside, places)  # pyright: ignore[reportUnknownArgumentType]


def _is_no_code(node: ast.AST, field: str) -> bool:
    """Return whether a field is an annotation, a decorator, an import or a list of names."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        return True
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
        return node.targets[0].id == "__all__"
    return field in ("annotation", "returns", "decorator_list", "bases", "type_params")


def _setter(node: ast.AST, name: str) -> Callable[[ast.AST], None]:
    return lambda other: setattr(node, name, other)


def _item_setter(items: list[ast.AST], i: int) -> Callable[[ast.AST], None]:
    return lambda other: items.__setitem__(i, other)


Change = tuple[str, Callable[[], None]]


def _changes(place: _Place) -> list[Change]:
    """Return the changes that a node offers, in words and as what makes them."""
    if not place.is_code:
        return []
    node = place.node
    changes: list[Change] = []
    for offers in (_of_compare, _of_operator, _of_constant, _of_condition, _of_call, _of_statement):
        changes += offers(node, place.replace)
    return changes


def _of_compare(node: ast.AST, _: Callable[[ast.AST], None]) -> list[Change]:
    if not isinstance(node, ast.Compare):
        return []
    changes: list[Change] = []
    for i, op in enumerate(node.ops):
        for other in _COMPARISONS[type(op)]:
            what = f"{type(op).__name__} -> {other.__name__}"
            changes.append((what, _put(node.ops, i, other())))
    return changes


def _put(items: list[ast.cmpop], i: int, other: ast.cmpop) -> Callable[[], None]:
    return lambda: items.__setitem__(i, other)


def _of_operator(node: ast.AST, replace: Callable[[ast.AST], None]) -> list[Change]:
    if isinstance(node, ast.BinOp | ast.AugAssign):
        return [
            (f"{type(node.op).__name__} -> {other.__name__}", _set_op(node, other()))
            for other in _OPERATORS.get(type(node.op), ())
        ]
    if isinstance(node, ast.BoolOp):
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        return [(f"-> {type(other).__name__}", lambda: setattr(node, "op", other))]
    if isinstance(node, ast.UnaryOp):
        name = type(node.op).__name__
        return [(f"without {name}", lambda: replace(node.operand))]
    return []


def _set_op(node: ast.BinOp | ast.AugAssign, other: ast.operator) -> Callable[[], None]:
    return lambda: setattr(node, "op", other)


def _of_constant(node: ast.AST, _: Callable[[ast.AST], None]) -> list[Change]:
    if not isinstance(node, ast.Constant):
        return []
    return [
        (f"{node.value!r} -> {other!r}", _set_value(node, other)) for other in _beside(node.value)
    ]


def _set_value(node: ast.Constant, other: float) -> Callable[[], None]:
    return lambda: setattr(node, "value", other)


def _beside(value: object) -> list[float]:
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int):
        return [value + 1, value - 1]
    if isinstance(value, float):
        return [value * 1.25, value * 0.8] if value else [1.0, -1.0]
    return []


def _of_condition(node: ast.AST, _: Callable[[ast.AST], None]) -> list[Change]:
    if not isinstance(node, ast.If | ast.IfExp | ast.While):
        return []
    test = node.test
    negated = ast.UnaryOp(ast.Not(), test)
    return [
        ("negated", lambda: setattr(node, "test", negated)),
        ("always", lambda: setattr(node, "test", ast.Constant(True))),
        ("never", lambda: setattr(node, "test", ast.Constant(False))),
    ]


def _of_call(node: ast.AST, replace: Callable[[ast.AST], None]) -> list[Change]:
    if not isinstance(node, ast.Call):
        return []
    func, changes = node.func, list[Change]()
    name = func.id if isinstance(func, ast.Name) else getattr(func, "attr", "")
    if name in _CALLS:
        what = f"{name} -> {_CALLS[name]}"
        field = "id" if isinstance(func, ast.Name) else "attr"
        changes.append((what, lambda: setattr(func, field, _CALLS[name])))
    if name == "abs":
        changes.append(("without abs", lambda: replace(node.args[0])))
    return changes


def _of_statement(node: ast.AST, replace: Callable[[ast.AST], None]) -> list[Change]:
    if isinstance(node, ast.Return) and not _is_none(node.value):
        return [("return None", lambda: setattr(node, "value", None))]
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return []  # a docstring
    if isinstance(node, ast.Expr | ast.AugAssign | ast.Raise | ast.Continue | ast.Delete):
        return [("left out", lambda: replace(ast.Pass()))]
    if isinstance(node, ast.Assign) and not isinstance(node.targets[0], ast.Name | ast.Tuple):
        return [("left out", lambda: replace(ast.Pass()))]
    return []


def _is_none(node: ast.AST | None) -> bool:
    return node is None or (isinstance(node, ast.Constant) and node.value is None)


class _Swap(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports a mutant in place of its module."""

    def __init__(self, mutant: Mutant) -> None:
        self._name = f"ikservo.guard.{mutant.module}"
        self._mutant = mutant

    def find_spec(
        self, fullname: str, path: object = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Answer for the mutated module only."""
        if fullname != self._name:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=str(self._mutant.path))

    def exec_module(self, module: ModuleType) -> None:
        """Run the mutant's code as the module's."""
        code = compile(self._mutant.tree, str(self._mutant.path), "exec")
        exec(code, module.__dict__)


def _preload() -> None:
    """Import once what every mutant's process needs, except the guard and what stands on it."""
    sys.path[:0] = [str(ROOT), str(ROOT / "sim")]
    os.chdir(ROOT)
    for name in ("pytest", "hypothesis", "numpy", "numba", "tests.guard.arms"):
        importlib.import_module(name)
    importlib.import_module(f"ikservo.guard.{KERNEL}")


def _forget_guard(mutant: Mutant) -> None:
    keep = f"ikservo.guard.{KERNEL}"
    if mutant.module == KERNEL:
        import numba  # noqa: PLC0415

        numba.config.DISABLE_JIT = True
        keep = ""
    for name in list(sys.modules):
        ours = name.startswith(
            ("ikservo.guard", "ikservo.arm", "tests.guard.test_", "tests.guard.gates")
        )
        if (ours and name != keep) or (not keep and name == "ikservo.ik.kernel.compiling"):
            del sys.modules[name]


def _tests_of(module: str) -> list[list[str]]:
    """Return the test files, the module's own ones first; campaigns on whole arms are left out.

    The kernel's mutants run as plain Python, a thousand times slower, and with its own tests only.
    """
    files = sorted(str(path) for path in TESTS.glob("test_*.py") if "promise" not in path.name)
    own = [path for path in files if module in Path(path).name]
    if module == KERNEL:
        return [own]
    return [own, [path for path in files if path not in own]]


def _survives(mutant: Mutant) -> bool:
    """Run the tests on a mutant, in this process; return whether all of them passed."""
    import pytest  # noqa: PLC0415

    _forget_guard(mutant)
    sys.meta_path.insert(0, _Swap(mutant))
    options = ["-x", "-q", "-p", "no:cacheprovider", "--no-header", "--timeout=0"]
    options += ["--assert=plain", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return all(pytest.main([*options, *files]) == 0 for files in _tests_of(mutant.module))


def _fork(mutant: Mutant) -> int:
    """Start a mutant's process; it ends with 0 where the mutant was killed."""
    pid = os.fork()
    if pid:
        return pid
    code = 0
    try:
        devnull = os.open(os.devnull, os.O_WRONLY)
        os.dup2(devnull, 1)
        os.dup2(devnull, 2)
        code = 1 if _survives(mutant) else 0
    except BaseException:  # a mutant that cannot be imported is as dead as one that fails a test
        code = 0
    finally:
        os._exit(code)
    return 0


def run(mutants: list[Mutant], jobs: int) -> list[Mutant]:
    """Return the mutants that no test killed."""
    waiting, survivors = list(reversed(mutants)), list[Mutant]()
    running: dict[int, tuple[Mutant, float]] = {}
    done = 0
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            running[_fork(mutant)] = (mutant, time.monotonic())
        for pid in list(running):
            mutant, started_s = running[pid]
            ended, status = os.waitpid(pid, os.WNOHANG)
            if not ended and time.monotonic() - started_s > TIMEOUT_S:
                os.kill(pid, signal.SIGKILL)
                ended, status = os.waitpid(pid, 0)
                print(f"{_report(mutant)}took longer than {TIMEOUT_S:.0f} s", file=sys.stderr)
            if not ended:
                continue
            del running[pid]
            done += 1
            if os.WIFEXITED(status) and os.WEXITSTATUS(status) == 1:
                survivors.append(mutant)
                print(_report(mutant), flush=True)
            if done % 50 == 0:
                print(f"{done} of {len(mutants)} ...", file=sys.stderr, flush=True)
        time.sleep(0.005)
    return survivors


def _report(mutant: Mutant) -> str:
    place = mutant.path.relative_to(ROOT)
    return f"{place}:{mutant.line}: {mutant.what}\n{mutant.difference()}\n"


def _is_sound(module: str) -> bool:
    """Return whether the tests pass on the unchanged module, so that a failure means something."""
    tree = ast.parse((GUARD / f"{module}.py").read_text())
    same = Mutant(module, 1, "unchanged", copy.deepcopy(tree))
    _, status = os.waitpid(_fork(same), 0)
    return os.WIFEXITED(status) and os.WEXITSTATUS(status) == 1


def main() -> int:
    """Run all mutants and say how many were killed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("modules", nargs="*", help="modules of ikservo/guard (all)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--list", action="store_true", help="print the mutants and run none")
    parser.add_argument("--line", type=int, help="only the mutants of one line")
    given = parser.parse_args()
    names = given.modules or sorted(p.stem for p in GUARD.glob("*.py") if p.stem != "__init__")
    every = [mutant for name in names for mutant in mutants_of(name)]
    every = [mutant for mutant in every if given.line in (None, mutant.line)]
    excused = [mutant for mutant in every if mutant.excuse()]
    tried = [mutant for mutant in every if not mutant.excuse()]
    if given.list:
        print(*(_report(mutant) for mutant in tried), sep="\n")
        return 0
    os.nice(5)
    _preload()
    unsound = [name for name in names if not _is_sound(name)]
    if unsound:
        print(f"The tests fail without any mutant of: {', '.join(unsound)}.", file=sys.stderr)
        return 2
    survivors = run(tried, given.jobs)
    killed = len(tried) - len(survivors)
    print(
        f"{len(every)} mutants: {killed} killed, {len(survivors)} survived, {len(excused)} excused"
    )
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
