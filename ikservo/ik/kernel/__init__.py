"""The production solver's inner loops, compiled: scalar arithmetic on arrays laid out before.

Importing this package imports numba; ``ikservo.ik`` does so at the first solve.
"""
