"""A planar arm of ten links, to measure costs that must not grow with the number of links."""

from __future__ import annotations

from pathlib import Path

from ikservo.model import load_model

__all__ = ["ten_links"]

BAR = '<origin xyz="0.03 0 0"/><geometry><box size="0.06 0.02 0.02"/></geometry>'
LINK = f"""  <link name="l{{i}}">
  <visual>{BAR}</visual>
  <collision>{BAR}</collision>
  </link>
"""
JOINT = """  <joint name="j{i}" type="revolute"><parent link="l{before}"/><child link="l{i}"/>
  <origin xyz="{x} 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" effort="1.5" velocity="6"/></joint>
"""
TIP = """  <link name="tool"/>
  <joint name="tip" type="fixed"><parent link="l{i}"/><child link="tool"/>
  <origin xyz="0.06 0 0"/></joint>
"""
SERVO = """[[joints]]
name = "j{i}"
role = "arm"
zero_from = "nominal"
servo = {{ id = {i}, model = "XL430-W250", sign = 1, zero_tick = 2048 }}
"""


def ten_links(folder: Path) -> Path:
    """Write the arm into a folder and return its arm.toml."""
    links = [LINK.format(i=i) for i in range(11)]
    joints = [JOINT.format(i=i, before=i - 1, x=0.0 if i == 1 else 0.06) for i in range(1, 11)]
    urdf = f'<robot name="ten">\n{"".join(links + joints)}{TIP.format(i=10)}</robot>\n'
    (folder / "arm.urdf").write_text(urdf, encoding="utf-8")
    head = (load_model("planar3").path).read_text(encoding="utf-8").partition("[[joints]]")[0]
    head = head.replace('"planar3"', '"ten"').replace("Three servos", "Ten servos")
    servos = "".join(SERVO.format(i=i) for i in range(1, 11))
    pose = ", ".join(f"j{i} = {12.0 if i > 1 else -50.0}" for i in range(1, 11))
    poses = "".join(f"[poses.{name}]\ndeg = {{ {pose} }}\n" for name in ("rest", "home", "zero"))
    path = folder / "arm.toml"
    path.write_text(head + servos + poses, encoding="utf-8")
    return path
