"""Use an arm of your own: the folder own_arm describes it by two files."""

from pathlib import Path

import ikservo

FILE = Path(__file__).parent / "own_arm" / "arm.toml"

model = ikservo.load_model(FILE)
print(f"{model.title}: {', '.join(model.chain.names)}")

result = ikservo.solve(model.chain, ikservo.Target((0.12, 0.05, 0.12)))
print(f"reached: {result.reached}, error {result.position_error_m * 1000:.3f} mm")

with ikservo.open_arm(FILE, port="sim") as arm:
    report = arm.move_to((0.12, 0.05, 0.12))
    print(f"measured error {report.error_m * 1000:.2f} mm")
