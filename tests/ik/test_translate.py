"""The translator refuses, with file and line, code that C would execute differently."""

import importlib.util
import sys
from pathlib import Path

import pytest

FILE = Path(__file__).parents[2] / "tools" / "kernel" / "translate.py"
HEAD = """
import math
import numpy as np
from ikservo.kernels.compiled import entry
from pack.other import SHARED, helper

A, B = 2, -0.5
_TABLE = (1, 2)


def check(v: Vector, m: Matrix, x: float, i: int) -> bool:
    return True


def write(v: Vector) -> float:
    v[0] = 1.0
    return v[0]


def read(v: Vector) -> float:
    return v[0]


@entry(check)
def kernel(v: Vector, m: Matrix, x: float, i: int) -> float:
"""
OTHER = """
SHARED = 3


def helper(x: float) -> float:
    return x + 1.0
"""


@pytest.fixture(scope="module")
def translate():
    spec = importlib.util.spec_from_file_location("translate", FILE)
    module = importlib.util.module_from_spec(spec)
    sys.modules["translate"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def translated(translate, tmp_path):
    (tmp_path / "pack").mkdir()

    def run(body, head=HEAD):
        (tmp_path / "pack" / "kernels.py").write_text(head + body)
        (tmp_path / "pack" / "other.py").write_text(OTHER)
        return translate.translate(tmp_path, ["pack.kernels"])[0]

    return run


def body(*lines):
    return "".join(f"    {line}\n" for line in lines)


@pytest.mark.parametrize(
    "lines",
    [
        ["return x ** 2"],
        ["return math.hypot(x, x)"],
        ["return math.e"],
        ["return x % 1.0"],
        ["return float(i // A * i % i)"],
        ["return float(i << 1)"],
        ["return abs(i)"],
        ["return max(x, 1)"],
        ["return min(x)"],
        ["return sum(v)"],
        ["return unknown(x)"],
        ["return helper(i)"],
        ["return helper(x=x)"],
        ["return v"],
        ["return i"],
        ["return _TABLE[0]"],
        ["return v[x]"],
        ["return v[0:1][0]"],
        ["return v[::2][0]"],
        ["return m[0][1][0]"],
        ["return float(v.shape[0])"],
        ["return float(m.size)"],
        ["return (lambda: x)()"],
        ["return [x][0]"],
        ["return 1.0 if i else 2.0"],
        ["return 1.0 if x > 0.0 else 2"],
        ["return 1.0 if 0.0 < helper(x) < 1.0 else 2.0"],
        ["return 1.0 if v == v else 2.0"],
        ["return 1.0 if x is None else 2.0"],
        ["if x > 0.0:", "    return x"],
        ["while x > 0.0:", "    x -= 1.0"],
        ["while True:", "    pass"],
        ["for y in v:", "    x += y", "return x"],
        ["for k in range(0, 9, 2):", "    x += 1.0", "return x"],
        ["for k in range(3):", "    k = 1", "return x"],
        ["for k in range(3):", "    x += 1.0", "return float(k)"],
        ["for k in range(3):", "    x += 1.0", "else:", "    x = 0.0", "return x"],
        ["y = 1", "y = 2.0", "return y"],
        ["y: float = 1.0", "return y"],
        ["w = v", "return x"],
        ["w = m[0]", "w = m[1]", "return x"],
        ["v = m[0]", "return x"],
        ["v[0] = True", "return x"],
        ["m[0] = v", "return x"],
        ["v[:] = m[0]", "return x"],
        ["a, b = x", "return x"],
        ["a, b = c, d = x, x", "return x"],
        ["a = b = helper(x)", "return x"],
        ["w = np.empty(i)", "return x"],
        ["w = np.zeros(3)", "return x"],
        ["w = np.empty(3, np.float32)", "return x"],
        ["v[0] += write(v)", "return x"],
        ["return read(v) + write(v)"],
        ["return v[0] + write(v)"],
        ["return write(v) + write(v)"],
        ["global x", "return x"],
        ["def inner() -> None:", "    return", "return x"],
        ["try:", "    x = 1.0", "finally:", "    x = 2.0", "return x"],
        ["return kernel(v, m, x, i)"],
    ],
)
def test_kernel_translator_refuses_unsupported_code_with_line(translate, translated, lines):
    with pytest.raises(translate.TranslationError, match=r"kernels\.py:\d+: .+"):
        translated(body(*lines))


@pytest.mark.parametrize(
    "lines",
    [
        ["return x * SHARED + B"],
        ["return helper(x)"],
        ["a, b = x, 2.0 * x", "a, b = b, a", "return a - b"],
        ["a = b = 0.0", "return a + b"],
        ["x += write(v)", "return x"],
        ["return 1.0 if x > 0.0 and write(v) > 0.0 else 2.0"],
        ["row = m[i]", "tail = v[i + 1 :]", "return row[0] + tail[0]"],
        ["w = np.empty((A, 3))", "w[1, 2] = x", "return w[1, 2]"],
        ["for k in range(i - 1, -1, -1):", "    x += v[k]", "return x"],
        ["return 1.0 if 0.0 <= x < i else 2.0"],
        ["return float(i % 3 + i // 2 + int(x) + len(v) + m.shape[1])"],
        ["return -x / 3"],
    ],
)
def test_kernel_translator_accepts_supported_code(translated, lines):
    assert "static double kernels_kernel(" in translated(body(*lines))


@pytest.mark.parametrize(
    "head",
    [
        HEAD.replace("x: float, i: int) -> float", "x: float, i: int = 1) -> float"),
        HEAD.replace("x: float, i: int) -> float", "x: float, *i: int) -> float"),
        HEAD.replace("x: float, i: int) -> float", "x: float, i) -> float"),
        HEAD.replace("x: float, i: int) -> float", "x: str, i: int) -> float"),
        HEAD.replace("x: float, i: int) -> bool", "x: float) -> bool"),
        HEAD.replace("return True", "v[0] = 1.0\n    return True"),
        HEAD.replace("-> bool:\n    return True", "-> float:\n    return 1.0"),
        HEAD.replace("@entry(check)", "@cache"),
        HEAD.replace("_TABLE = (1, 2)", "A = 3"),
    ],
)
def test_kernel_translator_refuses_unsupported_entry_or_constant(translate, translated, head):
    assert head != HEAD
    with pytest.raises(translate.TranslationError, match=r"kernels\.py:\d+: .+"):
        translated(body("return x"), head)


@pytest.mark.parametrize("lines", [["row = m[1]"], ["y, row = x, m[1]"]])
def test_kernel_needs_only_its_output_arrays_writable(translated, lines):
    code = translated(body(*lines, "row[0] = read(v)", "return x"))
    assert '{"kernel", "vMfi", \'f\', enter_kernel}' in code


def test_kernel_translator_marks_vectorised_function(translated):
    code = translated(body("return read(v)"), HEAD.replace("def read", "@vectorised\ndef read"))
    assert "static VECTORISED double kernels_read(" in code
    assert "static double kernels_write(" not in code  # nothing calls it


def test_kernel_translator_refuses_unknown_decorator(translate, translated):
    with pytest.raises(translate.TranslationError, match="@cache is not known"):
        translated(body("return read(v)"), HEAD.replace("def read", "@cache\ndef read"))


def test_kernel_translator_refuses_imported_function(translate, translated):
    with pytest.raises(translate.TranslationError, match=r"sqrt\(\) is not known"):
        translated(body("return sqrt(x)"), HEAD.replace("import math", "from math import sqrt"))
