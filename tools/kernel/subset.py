"""The types, operators and functions that kernels may use, and what they are in C."""

from __future__ import annotations

import ast

__all__ = ["ARRAYS", "C_TYPES", "MATH", "NUMBERS", "SIGNS", "WHOLE"]

NUMBERS = ("float", "int")
# Item type and dimensions of an array, and its letter in the table of entries.
ARRAYS = {
    "Vector": ("double", 1, "v"), "Matrix": ("double", 2, "m"),
    "IntVector": ("int64_t", 1, "w"), "IntMatrix": ("int64_t", 2, "x"),
}  # fmt: skip
C_TYPES = {name: name for name in (*ARRAYS, "FloatPair")}
C_TYPES |= {"float": "double", "int": "int64_t", "bool": "bool", "None": "void"}
# Number of arguments of each function of math.
MATH = {"sqrt": 1, "sin": 1, "cos": 1, "asin": 1, "acos": 1, "floor": 1, "ceil": 1}
MATH |= {"atan2": 2, "copysign": 2}
SIGNS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">",
    ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.And: " && ", ast.Or: " || ",
}  # fmt: skip
WHOLE: dict[type[ast.AST], str] = {ast.FloorDiv: "floor_div", ast.Mod: "floor_mod"}
