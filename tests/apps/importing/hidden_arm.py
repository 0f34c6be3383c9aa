"""An arm on a simulated bus whose ids, signs and zeros are unknown to the program."""

from tests.oracle import CONFIGS

IDS = {"shoulder_pan": 9, "shoulder_lift": 4, "elbow_flex": 11, "wrist_flex": 2, "wrist_roll": 30,
       "gripper": 7}  # fmt: skip
SIGNS = {"shoulder_pan": -1, "shoulder_lift": 1, "elbow_flex": -1, "wrist_flex": -1,
         "wrist_roll": 1, "gripper": -1}  # fmt: skip


def hide_arm(folder):
    """Write the arm's folder; return its arm.toml, for the simulator."""
    folder.mkdir(exist_ok=True)
    text = (CONFIGS / "so101" / "arm.toml").read_text()
    for i, name in enumerate(IDS, start=1):
        old = f'id = {i}, model = "STS3215", sign = 1, zero_tick = 2048'
        assert old in text
        zero = f"sign = {SIGNS[name]}, zero_tick = {1900 + 40 * i}"
        text = text.replace(old, f'id = {IDS[name]}, model = "STS3215", {zero}')
    (folder / "arm.toml").write_text(text)
    (folder / "arm.urdf").write_text((CONFIGS / "so101" / "arm.urdf").read_text())
    return folder / "arm.toml"
