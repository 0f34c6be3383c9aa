"""Translate kernels, plain Python on arrays, to C. The subset is described in docs/kernels.md.

Code outside the subset is refused with its file and line, so that C and Python never differ, not
even in the last bit. Uses only the standard library, because it runs when ikservo is built.
"""

from __future__ import annotations

import ast
import math
import sys
from functools import reduce
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from sources import Module, Number, Sources, TranslationError
from subset import ARRAYS, C_TYPES, MATH, NUMBERS, SIGNS, WHOLE

__all__ = ["TranslationError", "translate"]

Typed = tuple[str, str]
"""An expression in C, and its type in Python."""


class Program:
    """The entries of some modules and all functions that they need, in C."""

    def __init__(self, root: Path) -> None:
        self.sources, self.functions = Sources(root), dict[tuple[str, str], Function]()
        self.c, self.table = list[str](), list[str]()

    def function(self, module: Module, name: str, node: ast.AST) -> Function:
        """Return a function; translate it first if it was not yet."""
        home = self.sources.home(module, name, node)
        key = (home.name, name)
        if key not in self.functions:
            self.functions[key] = Function(self, home, home.functions[name])
            self.functions[key].translate()
        if not self.functions[key].is_complete:
            raise module.refusal(node, f"{name}() calls itself")
        return self.functions[key]

    def add_entries(self, module: Module) -> None:
        """Translate every function with ``@entry(check)``, and the check of its arrays."""
        for node in list(module.functions.values()):
            run = self.function(module, node.name, node) if node.decorator_list else None
            if run and run.check:
                self._add_entry(node, run, self.function(module, run.check, node))

    def _add_entry(self, node: ast.FunctionDef, run: Function, check: Function) -> None:
        if check.given != run.given or check.returns != "bool" or check.writes:
            raise run.module.refusal(node, "The check has the same parameters and returns a bool")
        letters = ""
        for name, kind in run.given.items():
            letter = ARRAYS[kind][2] if kind in ARRAYS else kind[0]
            letters += letter.upper() if name in run.writes else letter
        given = ", ".join(f"as_{kind}(a + {i})" for i, kind in enumerate(run.given.values()))
        result = {"None": "", "float": "out->real = "}.get(run.returns, "out->whole = ")
        self.c.append(
            f"static bool enter_{node.name}(const Argument *a, Argument *out) {{\n"
            f"    if (!{check.c_name}({given})) return false;\n"
            f"    {result}{run.c_name}({given});\n    return true;\n}}\n"
        )
        row = f'{node.name}", "{letters}", \'{run.returns[0]}\', enter_{node.name}'
        self.table.append(f'    {{"{row}}},')


class Function:
    """One function: its locals with their types, and its statements in C."""

    def __init__(self, program: Program, module: Module, node: ast.FunctionDef) -> None:
        self.program, self.module, self.node = program, module, node
        self.constant = program.sources.constant
        self.c_name = f"{module.name.rpartition('.')[2]}_{node.name}"
        self.check, self.modifier, self.writes = "", "static", set[str]()
        self.depth, self.is_complete = 1, False
        self.lines, self.memory, self.loops = list[str](), list[str](), set[str]()
        rest = (node.args.vararg, node.args.kwarg, *node.args.kwonlyargs, *node.args.defaults)
        if any(rest) or node.args.posonlyargs:
            raise module.refusal(node, "Parameters have a name and a type only")
        for mark in node.decorator_list:
            match mark:
                case ast.Call(ast.Name("entry"), [ast.Name(check)], []):
                    self.check = check
                case ast.Name("vectorised"):
                    self.modifier = "static VECTORISED"
                case _:
                    raise module.refusal(node, f"@{ast.unparse(mark)} is not known")
        self.given = {each.arg: self._annotated(each.annotation) for each in node.args.args}
        self.returns, self.types = self._annotated(node.returns), self.given.copy()
        # The parameter to which each array belongs; empty for memory of the function.
        self.behind = {name: name for name, kind in self.given.items() if kind in ARRAYS}

    def translate(self) -> None:
        """Add the function to the program, after those that it calls."""
        head = ", ".join(f"{C_TYPES[kind]} v_{name}" for name, kind in self.given.items())
        for statement in self.node.body:
            self._statement(statement)
        if self.returns != "None" and not _returns(self.node.body[-1]):
            raise self.module.refusal(self.node, "The end of the function returns nothing")
        own = [
            f"    {C_TYPES[kind]} v_{name} = {'{0}' if kind in ARRAYS else '0'};"
            for name, kind in self.types.items()
            if name not in self.given
        ]
        first = f"{self.modifier} {C_TYPES[self.returns]} {self.c_name}({head}) {{"
        where = f"/* {self.module.name}, line {self.node.lineno} */"
        self.program.c += [where, first, *self.memory, *own, *self.lines, "}\n"]
        self.is_complete = True

    def _annotated(self, node: ast.expr | None) -> str:
        kind = ast.unparse(node) if node else ""
        kind = "FloatPair" if kind == "tuple[float, float]" else kind
        if kind not in C_TYPES:
            raise self.module.refusal(node or self.node, "A parameter or result of no known type")
        return kind

    # --- statements ---

    def _block(self, head: str, statements: list[ast.stmt]) -> None:
        self._emit(head + " {")
        for node in statements:
            self._statement(node)
        self._emit("}")

    def _emit(self, line: str) -> None:
        self.depth -= line.startswith("}")
        self.lines.append("    " * self.depth + line)
        self.depth += line.endswith("{")

    def _statement(self, node: ast.stmt) -> None:  # noqa: PLR0912  # one case per kind
        match node:
            case ast.Expr(ast.Constant(str())) if node is self.node.body[0]:
                pass  # the docstring
            case ast.Expr(ast.Call() as call):
                self._emit(f"{self._value(call)[0]};")
            case ast.Assign([ast.Name(name)], ast.Call(function, sizes)) if (
                ast.unparse(function) == "np.empty"
            ):
                self._allocate(node, name, sizes)
            case ast.Assign([ast.Tuple(targets)], value):
                self._assign(targets, value)
            case ast.Assign(targets, value) if len(targets) == 1 or isinstance(value, ast.Constant):
                for target in targets:
                    self._assign([target], value)
            case ast.AugAssign(target, operator, value):
                whole = ast.copy_location(ast.BinOp(target, operator, value), node)
                self._assign([target], whole)
            case ast.If(test, body, orelse):
                self._block(f"if ({self._typed(test, 'bool')})", body)
                if orelse:
                    self._block("else", orelse)
            case ast.While(test, body, []):
                self._block(f"while ({self._typed(test, 'bool')})", body)
            case ast.For(ast.Name(i), ast.Call(ast.Name("range"), limits, []), _, []):
                self._loop(node, i, limits)
            case ast.Break() | ast.Continue():
                self._emit(f"{ast.unparse(node)};")
            case ast.Return(None) if self.returns == "None":
                self._emit("return;")
            case ast.Return(ast.Tuple([first, second])) if self.returns == "FloatPair":
                pair = f"{self._typed(first, 'float')}, {self._typed(second, 'float')}"
                self._emit(f"return (FloatPair){{{pair}}};")
            case ast.Return(ast.expr() as value) if self.returns not in ARRAYS:
                self._emit(f"return {self._typed(value, self.returns)};")
            case _:
                raise self.module.refusal(node)

    def _assign(self, targets: list[ast.expr], value: ast.expr) -> None:
        """Evaluate all values, then assign them: a, b = c, d and a, b = f() and a = b."""
        sources = value.elts if isinstance(value, ast.Tuple) else [value]
        values = [self._value(each) for each in sources]
        self._emit("{")
        for i, (code, kind) in enumerate(values):
            if kind == "None" or (kind in ARRAYS and not isinstance(sources[i], ast.Subscript)):
                raise self.module.refusal(value, f"{ast.unparse(value)} cannot be assigned")
            self._emit(f"{C_TYPES[kind]} new_{i} = {code};")
        new = [(f"new_{i}", kind) for i, (_, kind) in enumerate(values)]
        if values[0][1] == "FloatPair":
            new = [("new_0.first", "float"), ("new_0.second", "float")]
        if len(new) != len(targets):
            raise self.module.refusal(value)
        for i, (target, (code, kind)) in enumerate(zip(targets, new, strict=True)):
            self._emit(f"{self._target(target, kind, sources[i % len(sources)])} = {code};")
        self._emit("}")

    def _target(self, node: ast.expr, kind: str, source: ast.expr) -> str:
        """Return the target of an assignment in C, and note that it is assigned."""
        if isinstance(node, ast.Subscript):
            item, wanted = self._item(node)
            if wanted not in NUMBERS or kind not in (wanted, "int"):
                raise self.module.refusal(node, f"{ast.unparse(node)} takes no {kind}")
            self._note_write(node)
            return item
        if not isinstance(node, ast.Name) or node.id in self.loops or node.id in self.behind:
            raise self.module.refusal(node, f"{ast.unparse(node)} cannot be assigned here")
        if self.types.setdefault(node.id, kind) != kind:
            raise self.module.refusal(node, f"{node.id} is {self.types[node.id]} and {kind}")
        if kind in ARRAYS:
            self.behind[node.id] = self._array_behind(source)
        return f"v_{node.id}"

    def _allocate(self, node: ast.stmt, name: str, given: list[ast.expr]) -> None:
        """Translate np.empty: memory of a constant size that belongs to the call."""
        sizes = given[0].elts if isinstance(given[0], ast.Tuple) else given[:1]
        shape = [self._typed(each, "int") for each in sizes]
        item = {(): "double", ("np.int64",): "int64_t"}.get(tuple(map(ast.unparse, given[1:])), "")
        kinds = {(each[0], each[1]): kind for kind, each in ARRAYS.items()}
        kind = kinds.get((item, len(shape)), "")
        if not kind or name in self.types or not all(each.isdecimal() for each in shape):
            raise self.module.refusal(node)
        self.types[name], self.behind[name] = kind, ""
        self.memory.append(f"    {item} memory_{name}[{' * '.join(shape)}];")
        self._emit(f"v_{name} = ({kind}){{memory_{name}, {', '.join(shape)}}};")

    def _loop(self, node: ast.For, i: str, limits: list[ast.expr]) -> None:
        """Translate for i in range(...); i is known inside only."""
        step = ast.unparse(limits[2]) if len(limits) == 3 else "1"
        codes = ["0", *(self._typed(each, "int") for each in limits[:2])][-2:]
        if i in self.types or step not in ("1", "-1"):
            raise self.module.refusal(node, f"{i} is in use, or the step is neither 1 nor -1")
        self.types[i] = "int"
        self.loops.add(i)
        first, sign = f"int64_t v_{i} = {codes[0]}, end_{i} = {codes[1]}", "<>"[step == "-1"]
        self._block(f"for ({first}; v_{i} {sign} end_{i}; v_{i} += {step})", node.body)
        self.loops.remove(i)
        del self.types[i]

    # --- expressions ---

    def _value(self, node: ast.expr) -> Typed:
        self._check_order(node)
        return self._expression(node)

    def _typed(self, node: ast.expr, *wanted: str) -> str:
        code, kind = self._value(node)
        if kind not in wanted:
            raise self.module.refusal(node, f"{ast.unparse(node)} is {kind}, not {wanted[0]}")
        return code

    def _expression(self, node: ast.expr) -> Typed:  # noqa: PLR0912
        match node:
            case ast.Constant(bool(value)):
                return str(value).lower(), "bool"
            case ast.Constant(int() | float() as value):
                return _literal(value)
            case ast.Name(name) if name in self.types:
                return f"v_{name}", self.types[name]
            case ast.Name(name) if (known := self.constant(self.module, name)) is not None:
                return _literal(known)
            case ast.Attribute(ast.Name("math"), "pi" | "inf" as name):
                return _literal(getattr(math, name))
            case ast.UnaryOp(ast.USub(), operand):
                return f"(-{self._typed(operand, *NUMBERS)})", self._expression(operand)[1]
            case ast.UnaryOp(ast.Not(), operand):
                return f"(!{self._typed(operand, 'bool')})", "bool"
            case ast.BinOp():
                return self._arithmetic(node)
            case ast.BoolOp(operator, values):
                parts = [self._typed(each, "bool") for each in values]
                return f"({SIGNS[type(operator)].join(parts)})", "bool"
            case ast.Compare():
                return self._comparison(node), "bool"
            case ast.IfExp(test, body, orelse):
                one, kind = self._value(body)
                return f"({self._typed(test, 'bool')} ? {one} : {self._typed(orelse, kind)})", kind
            case ast.Call(function, arguments, []):
                return self._call(node, ast.unparse(function), list(map(self._value, arguments)))
            case ast.Subscript():
                return self._item(node)
            case _:
                raise self.module.refusal(node)

    def _arithmetic(self, node: ast.BinOp) -> Typed:
        left, right = self._expression(node.left), self._expression(node.right)
        kinds, operator = {left[1], right[1]}, type(node.op)
        if operator in SIGNS and kinds <= set(NUMBERS):
            kind = "int" if kinds == {"int"} else "float"
            return f"(({C_TYPES[kind]}){left[0]} {SIGNS[operator]} {right[0]})", kind
        if operator is ast.Div and kinds <= set(NUMBERS):
            return f"((double){left[0]} / (double){right[0]})", "float"
        if operator in WHOLE and kinds == {"int"} and right[0].strip("0").isdecimal():
            return f"{WHOLE[operator]}({left[0]}, {right[0]})", "int"
        raise self.module.refusal(node)

    def _comparison(self, node: ast.Compare) -> str:
        sides = [self._expression(each) for each in (node.left, *node.comparators)]
        # C evaluates the operand in the middle twice.
        plain = all(isinstance(each, ast.Name | ast.Constant) for each in node.comparators[:-1])
        parts: list[str] = []
        for (a, one), sign, (b, other) in zip(sides, node.ops, sides[1:], strict=False):
            same = one == other == "bool" and isinstance(sign, ast.Eq | ast.NotEq)
            if type(sign) not in SIGNS or not plain or not (same or {one, other} <= set(NUMBERS)):
                raise self.module.refusal(node)
            parts.append(f"({a} {SIGNS[type(sign)]} {b})")
        return f"({' && '.join(parts)})"

    def _call(self, node: ast.Call, name: str, given: list[Typed]) -> Typed:
        codes, kinds = [code for code, _ in given], [kind for _, kind in given]
        one, kind = given[0] if len(given) == 1 else ("", "")
        if name[5:] in MATH and name == f"math.{name[5:]}" and kinds == ["float"] * MATH[name[5:]]:
            return f"{name[5:]}({', '.join(codes)})", "float"
        if name in NUMBERS and kind in NUMBERS:
            return f"{'to_int' if name == 'int' != kind else f'({C_TYPES[name]})'}({one})", name
        if name == "abs" and kind == "float":
            return f"fabs({one})", kind
        if name == "len" and kind in ARRAYS:
            return f"{one}.rows", "int"
        alike = len(given) > 1 and len(set(kinds)) == 1 and kinds[0] in NUMBERS
        if name in ("min", "max") and alike:
            return reduce(lambda a, b: f"{name}_{kinds[0]}({a}, {b})", codes), kinds[0]
        if not isinstance(node.func, ast.Name):
            raise self.module.refusal(node)
        called = self.program.function(self.module, name, node)
        if list(called.given.values()) != kinds:
            raise self.module.refusal(node, f"{name}() takes {', '.join(called.given.values())}")
        for parameter, argument in zip(called.given, node.args, strict=True):
            if parameter in called.writes:
                self._note_write(argument)
        return f"{called.c_name}({', '.join(codes)})", called.returns

    def _item(self, node: ast.Subscript) -> Typed:
        """Translate an item, row or slice of an array, or a part of its shape."""
        if isinstance(node.value, ast.Attribute) and node.value.attr == "shape":
            code, index = self._typed(node.value.value, "Matrix", "IntMatrix"), node.slice
            if isinstance(index, ast.Constant) and index.value in (0, 1):
                return f"{code}.{'width' if index.value else 'rows'}", "int"
        code, kind = self._expression(node.value)
        number = "float" if kind in ("Vector", "Matrix") else "int"
        match kind, node.slice:
            case (("Matrix" | "IntMatrix"), ast.Tuple([row, column])):
                indices = f"{self._typed(row, 'int')}, {self._typed(column, 'int')}"
                return f"CELL({code}, {indices})", number
            case (("Vector" | "IntVector"), ast.expr() as index) if not isinstance(
                index, ast.Slice
            ):
                return f"ITEM({code}, {self._typed(index, 'int')})", number
            case "Vector", ast.Slice(ast.expr() as first, None, None):
                return f"tail_of({code}, {self._typed(first, 'int')})", kind
            case "Matrix", ast.expr() as row if not isinstance(row, ast.Slice):
                return f"row_of({code}, {self._typed(row, 'int')})", "Vector"
            case _:
                raise self.module.refusal(node)

    # --- what is written, and when ---

    def _array_behind(self, node: ast.expr) -> str:
        while isinstance(node, ast.Subscript):
            node = node.value
        return self.behind.get(ast.unparse(node), "")

    def _note_write(self, node: ast.expr) -> None:
        if self._array_behind(node):
            self.writes.add(self._array_behind(node))

    def _check_order(self, node: ast.expr) -> None:
        """Refuse a call that writes to an array beside others that read: C has no order there."""
        if isinstance(node, ast.BoolOp):  # its operands are evaluated one after the other
            return
        known = self.module.functions.keys() | self.module.origins.keys()
        calls = {
            each: self.program.function(self.module, ast.unparse(each.func), each)
            for each in ast.walk(node)
            if isinstance(each, ast.Call) and ast.unparse(each.func) in known
        }
        writing = [each for each, called in calls.items() if called.writes]
        if writing:
            inside = {id(each) for given in writing[0].args for each in ast.walk(given)}
            beside = [each for each in ast.walk(node) if id(each) not in inside]
            if len(calls) > 1 or any(isinstance(each, ast.Subscript) for each in beside):
                raise self.module.refusal(node, "A call that writes needs its own statement")


def _literal(value: Number) -> Typed:
    code = "INFINITY" if math.isinf(value) else repr(abs(value))
    return (f"(-{code})" if math.copysign(1.0, value) < 0 else code), type(value).__name__


def _returns(node: ast.stmt) -> bool:
    if isinstance(node, ast.If):
        return bool(node.orelse) and _returns(node.body[-1]) and _returns(node.orelse[-1])
    return isinstance(node, ast.Return)


def translate(root: Path, modules: list[str]) -> tuple[str, list[Path], str]:
    """Return the entries of some modules in C, the files they come from, and those files' digests.

    Args:
        root: The folder that holds the package.
        modules: Their dotted names.

    Raises:
        TranslationError: A kernel uses something outside the subset; names the file and line.
    """
    program = Program(root)
    for name in modules:
        program.add_entries(program.sources.load(name))
    table = ["static const Entry ENTRIES[] = {", *program.table, "    {NULL, NULL, 0, NULL},", "};"]
    return "\n".join([*program.c, *table, ""]), *program.sources.digests()
