"""Draw what the tip can reach in the vertical plane in front of the arm: workspace.png."""

import numpy as np
from matplotlib.figure import Figure

import ikservo

chain = ikservo.load_model("so101").chain
x_m, z_m = np.meshgrid(np.linspace(0.0, 0.54, 28), np.linspace(0.0, 0.6, 31))
points_m = np.column_stack([x_m.ravel(), np.zeros(x_m.size), z_m.ravel()])
reached = ikservo.solve_batch(chain, points_m).reached

figure = Figure(figsize=(5, 5))
axes = figure.add_subplot()
axes.scatter(*points_m[reached][:, [0, 2]].T, s=16)
axes.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", title=f"{reached.sum()} points reached")
figure.savefig("workspace.png")
print(f"workspace.png: {reached.sum()} of {reached.size} points can be reached")
