"""The small changes that a module's code offers: one of them makes a mutant."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass

__all__ = ["changed_trees"]

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


def changed_trees(source: str) -> Iterator[tuple[int, str, ast.Module]]:
    """Yield every changed module of a source, with the line and a description."""
    for index, place in enumerate(_walk(ast.parse(source))):
        for k in range(len(_changes(place))):
            tree = ast.parse(source)
            node = _walk(tree)[index]
            what, change = _changes(node)[k]
            change()
            line = getattr(node.node, "lineno", 0)
            yield line, what, ast.fix_missing_locations(tree)


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
    """Return whether a field is an annotation, a decorator, an import, a list of names, a check."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        return True
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
        return node.targets[0].id == "__all__"
    if isinstance(node, ast.keyword) and node.arg == "strict":
        return True  # of zip: makes sure of what is so
    return field in ("annotation", "returns", "decorator_list", "bases", "type_params")


def _setter(node: ast.AST, name: str) -> Callable[[ast.AST], None]:
    return lambda other: setattr(node, name, other)


def _item_setter(items: list[ast.AST], i: int) -> Callable[[ast.AST], None]:
    return lambda other: items.__setitem__(i, other)


Change = tuple[str, Callable[[], None]]


def _changes(place: _Place) -> list[Change]:
    """Return the possible changes of a node, with descriptions and replacements."""
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
