// The surroundings of the arm: table, reachable region, things to avoid, scale bar.

import { transform } from "./geometry.js";

const GRID_M = 0.1;
const GRID_LINES = 10; // on each side
const NEAR_M = 0.02; // the table is drawn from this depth on
const LEVEL = 0.02;
const FROM_ABOVE = 0.98;
const SCALES_M = [1, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001];
const MARGIN_PX = 16;
const MAX_WIDTH = 0.3; // largest scale bar, as a fraction of the drawing
const FACES = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];

// A camera's picture shows the table itself, and the region is drawn on the table.
export function backdropItems({ centre, floor }, things, { region, region_pose }, projection) {
  const { lens } = projection;
  return [
    ...(floor === null || lens ? [] : floorItems(centre, floor, projection)),
    ...(region === null ? [] : [regionItem(region, region_pose, projection)]),
    ...things.map((thing) => thingItem("keep_out", thing, projection)),
  ];
}

// The table: its edge in a level view, otherwise a grid.
function floorItems(centre, floor, projection) {
  const slope = Math.abs(projection.forward[2]);
  if (!projection.perspective && slope < LEVEL) return [tableEdge([centre[0], centre[1], floor], projection)];
  const [x, y] = centre.map((along) => Math.round(along / GRID_M) * GRID_M);
  const half = GRID_M * GRID_LINES;
  const corners = [[-half, -half], [half, -half], [half, half], [-half, half]].map(([u, v]) => [x + u, y + v, floor]);
  const sheet = { kind: "polygon", style: "floor", rings: [projection.projectClipped(corners, NEAR_M)] };
  const lines = gridLines(half).map((ends) => ends.map(([u, v]) => [x + u, y + v, floor]));
  const grid = lines.map((ends) => ({ kind: "polyline", style: "grid", points: projection.projectClipped(ends, NEAR_M) }));
  return slope > FROM_ABOVE && !projection.perspective ? grid : [sheet, ...grid];
}

// The table seen edge-on, as wide as the drawing, down to its lower end.
function tableEdge(level, projection) {
  const [, y] = projection.project(level);
  const { width, height } = projection;
  const bottom = Math.max(height, y);
  return { kind: "polygon", style: "floor", rings: [[[0, y], [width, y], [width, bottom], [0, bottom]]] };
}

function gridLines(half) {
  const offsets = Array.from({ length: 2 * GRID_LINES + 1 }, (_, i) => (i - GRID_LINES) * GRID_M);
  return [...offsets.map((at) => [[-half, at], [half, at]]), ...offsets.map((at) => [[at, -half], [at, half]])];
}

function regionItem(region, pose, projection) {
  const rings = region.map((ring) => projection.projectClipped(ring.map(([u, v]) => transform(pose, [u, v, 0])), NEAR_M));
  return { kind: "polygon", style: "reach", rings };
}

// The box around a thing: its six faces, filled together.
export function thingItem(style, { name, pose, half: [a, b, c] }, projection) {
  const corners = [];
  for (const x of [-a, a]) for (const y of [-b, b]) for (const z of [-c, c]) corners.push(transform(pose, [x, y, z]));
  const rings = FACES.map((face) => orient(projection.projectClipped(face.map((i) => corners[i]), NEAR_M)));
  return { kind: "polygon", style, rings, name };
}

// Faces that are filled together must turn the same way, or they have holes.
function orient(ring) {
  const area = ring.reduce((sum, [x, y], i) => {
    const [nextX, nextY] = ring[(i + 1) % ring.length];
    return sum + x * nextY - y * nextX;
  }, 0);
  return area < 0 ? ring.reverse() : ring;
}

// A scale bar of a round length at the lower left; none in a perspective view.
export function scaleItems({ perspective, scalePx, width, height }) {
  if (perspective) return [];
  const length = SCALES_M.find((metres) => metres * scalePx <= MAX_WIDTH * width) ?? SCALES_M.at(-1);
  const y = height - MARGIN_PX;
  const label = length >= 0.01 ? `${Math.round(100 * length)} cm` : `${Math.round(1000 * length)} mm`;
  return [
    { kind: "polyline", style: "scale", points: [[MARGIN_PX, y], [MARGIN_PX + length * scalePx, y]] },
    { kind: "text", style: "scale", at: [MARGIN_PX, y - 6], text: label },
  ];
}
