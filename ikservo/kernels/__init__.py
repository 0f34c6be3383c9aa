"""The production solver's inner loops: scalar arithmetic on packed arrays.

Plain Python that is translated to C if a compiler is available, see docs/kernels.md.
"""
