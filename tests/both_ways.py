"""Every call of a compiled kernel also runs the Python code, and both must give the same bits."""

import numpy as np
import pytest

from ikservo.kernels import compiled

needs_extension = pytest.mark.skipif(not compiled.is_compiled(), reason="no C compiler")


def run_both_ways(monkeypatch, module, name):
    """Replace a kernel by both versions; return a list that grows by one with each call."""
    machine_code, python, calls = getattr(module, name), compiled.uncompiled[name], []

    def both(*arguments):
        copies = [each.copy() if isinstance(each, np.ndarray) else each for each in arguments]
        result = machine_code(*arguments)
        assert python(*copies) == result
        for one, other in zip(arguments, copies, strict=True):
            np.testing.assert_array_equal(one, other, strict=True)
        calls.append(result)
        return result

    monkeypatch.setattr(module, name, both)
    return calls
