// Forward kinematics of the arm that the server describes once, see ikservo/apps/page/drawing/scene_graph.py.

import { multiply, rotation, translation } from "./geometry.js";

const MOTIONS = {
  revolute: rotation,
  prismatic: (axis, position) => translation(axis.map((along) => position * along)),
};

// Returns for each link T_world_link `pose`, the `position` of its joint, and `mount`: the pose at position 0.
export function placeLinks({ links }, positions) {
  const placed = new Map();
  let next = 0;
  for (const { name, parent, origin, joint, axis } of links) {
    const mount = parent === null ? origin : multiply(placed.get(parent).pose, origin);
    if (joint === "fixed") {
      placed.set(name, { mount, pose: mount, position: 0 });
      continue;
    }
    const position = positions[next++];
    placed.set(name, { mount, pose: multiply(mount, MOTIONS[joint](axis, position)), position });
  }
  return placed;
}
