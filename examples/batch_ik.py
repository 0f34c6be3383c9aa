"""Solve thousands of points in one call, on all cores."""

import time

import numpy as np

import ikservo

rng = np.random.default_rng(1)
chain = ikservo.load_model("so101").chain
points_m = rng.uniform((0.1, -0.2, 0.0), (0.35, 0.2, 0.3), (5000, 3))

start_s = time.perf_counter()
batch = ikservo.solve_batch(chain, points_m)
duration_s = time.perf_counter() - start_s

print(f"{batch.reached.mean() * 100:.0f} % of the points can be reached")
print(f"{len(points_m) / duration_s:,.0f} solutions per second")
