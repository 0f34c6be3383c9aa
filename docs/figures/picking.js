// Figure of hierarchical selection: a ray, boxes of links, shapes inside them.

import { addOutput, COLOURS, millimetres, Plane } from "./drawing.js";
import { forward } from "./planar.js";

const LINKS = [0.22, 0.2, 0.14];
const Q = [1.2, -0.9, -0.7];
const HALF_M = 0.028; // half the thickness of a link
const EYE = [0.62, -0.1];
const NAMES = ["upper arm", "forearm", "hand"];

/** A ray in the frame of a link: the link lies along x from 0 to its length. */
function toLocal([x, y], origin, heading) {
  const [dx, dy] = [x - origin[0], y - origin[1]];
  return [dx * Math.cos(heading) + dy * Math.sin(heading), dy * Math.cos(heading) - dx * Math.sin(heading)];
}

/** Where a ray (from, along) enters the box [x0, x1] x [y0, y1]; null if it passes by. */
function enterBox(from, along, low, high) {
  let [near, far] = [0, Infinity];
  for (const k of [0, 1]) {
    const ends = [(low[k] - from[k]) / along[k], (high[k] - from[k]) / along[k]].sort((a, b) => a - b);
    [near, far] = [Math.max(near, ends[0]), Math.min(far, ends[1])];
  }
  return near <= far ? near : null;
}

/** Where a ray enters a disc; null if it passes by. */
function enterDisc(from, along, centre, radius) {
  const [px, py] = [from[0] - centre[0], from[1] - centre[1]];
  const half = px * along[0] + py * along[1];
  const root = half * half - (px * px + py * py - radius * radius);
  return root < 0 ? null : -half - Math.sqrt(root);
}

/** Where a ray enters a capsule along x: two discs and the strip between them. */
function enterCapsule(from, along, linkLength) {
  const found = [
    enterDisc(from, along, [0, 0], HALF_M),
    enterDisc(from, along, [linkLength, 0], HALF_M),
    enterBox(from, along, [0, -HALF_M], [linkLength, HALF_M]),
  ].filter((t) => t !== null && t > 0);
  return found.length ? Math.min(...found) : null;
}

/** Each link: whether the ray meets its box, and where its shape. */
export function castRay(eye, towards) {
  const size = Math.hypot(towards[0] - eye[0], towards[1] - eye[1]) || 1;
  const along = [(towards[0] - eye[0]) / size, (towards[1] - eye[1]) / size];
  const points = forward(LINKS, Q);
  let heading = 0;
  return LINKS.map((linkLength, i) => {
    heading += Q[i];
    const from = toLocal(eye, points[i], heading);
    const direction = toLocal(along, [0, 0], heading);
    const box = enterBox(from, direction, [-HALF_M, -HALF_M], [linkLength + HALF_M, HALF_M]);
    const shape = box === null ? null : enterCapsule(from, direction, linkLength);
    return { name: NAMES[i], box, shape, along };
  });
}

/** The corners of a link's box in the plane. */
function corners(origin, heading, linkLength) {
  const [c, s] = [Math.cos(heading), Math.sin(heading)];
  const ends = [[-HALF_M, -HALF_M], [linkLength + HALF_M, -HALF_M], [linkLength + HALF_M, HALF_M], [-HALF_M, HALF_M]];
  return ends.map(([x, y]) => [origin[0] + c * x - s * y, origin[1] + s * x + c * y]);
}

export function picking(figure) {
  const plane = new Plane(figure, [-0.2, -0.2, 0.95, 0.75]);
  const output = addOutput(figure);
  const draw = (towards) => {
    const hits = castRay(EYE, towards);
    const nearest = hits.filter((hit) => hit.shape !== null).sort((a, b) => a.shape - b.shape)[0];
    const points = forward(LINKS, Q);
    plane.clear();
    let heading = 0;
    hits.forEach((hit, i) => {
      heading += Q[i];
      const colour = hit === nearest ? COLOURS.good : hit.shape !== null ? COLOURS.hit : COLOURS.other;
      plane.line([points[i], points[i + 1]], colour, 2 * HALF_M * plane.scale);
      plane.polygon(corners(points[i], heading, LINKS[i]), hit.box === null ? COLOURS.help : COLOURS.target, "none");
      plane.text(points[i + 1], hit.name);
    });
    const along = hits[0].along;
    plane.line([EYE, [EYE[0] + along[0], EYE[1] + along[1]]], COLOURS.help, 1.5, "6 4");
    plane.dot(EYE, COLOURS.arm, 7);
    plane.text(EYE, "eye");
    if (nearest) plane.cross([EYE[0] + along[0] * nearest.shape, EYE[1] + along[1] * nearest.shape], COLOURS.target);
    output.value = describe(hits, nearest);
  };
  plane.onDrag(draw);
  draw([0.1, 0.25]);
}

function describe(hits, nearest) {
  const lines = hits.map(({ name, box, shape }) => {
    if (box === null) return `${name}: the ray misses its box; the shape is not tested`;
    return `${name}: box met, ${shape === null ? "shape missed" : `shape met after ${millimetres(shape)}`}`;
  });
  return [...lines, `selected: ${nearest ? nearest.name : "nothing"}`].join("\n");
}
