// Outlines of the links on the screen: each capsule is the convex hull of the outlines of its two spheres.

import { add, cross, length, subtract, transform, unit } from "./geometry.js";

const CORNERS = 20;
const ROUND = Array.from({ length: CORNERS }, (_, i) => (2 * Math.PI * i) / CORNERS).map((angle) => [Math.cos(angle), Math.sin(angle)]);
const INSIDE = 0.9; // an eye inside a sphere is treated as just outside of it
const SAME_DEPTH_M = 1e-6; // links side by side are painted in the order of their names

// Returns link, depth and one ring of pixels for each of its capsules; the farthest link first.
export function outlineLinks({ links }, placed, projection) {
  const outlines = links.filter(({ capsules }) => capsules.length).map(({ name, capsules }) => {
    const ends = capsules.map((capsule) => capsule.ends.map((end) => transform(placed.get(name).pose, end)));
    const depths = ends.flat().map((end) => projection.depth(end));
    return {
      link: name,
      depth: Math.round(depths.reduce((sum, depth) => sum + depth) / depths.length / SAME_DEPTH_M),
      rings: ends.map((both, i) => convexHull(both.flatMap((end) => outlineSphere(end, capsules[i].radius, projection)))),
    };
  });
  return outlines.sort((a, b) => b.depth - a.depth || (a.link < b.link ? -1 : 1));
}

// From an eye at distance d the outline of a sphere of radius r is its circle of tangency: nearer by
// r²/d, and smaller by sqrt(1 - (r/d)²).
function outlineSphere(centre, radius, projection) {
  let { right, up } = projection;
  if (projection.perspective) {
    const away = subtract(centre, projection.eye);
    const ratio = Math.min(radius / length(away), INSIDE);
    radius = ratio * length(away) * Math.sqrt(1 - ratio ** 2);
    centre = add(centre, away, -(ratio ** 2));
    right = unit(cross(away, projection.up));
    up = unit(cross(right, away));
  }
  return ROUND.map(([x, y]) => projection.project(add(add(centre, right, x * radius), up, y * radius)));
}

// Andrew's monotone chain. All hulls turn the same way, so that those of a link fill as one.
export function convexHull(points) {
  const sorted = points.toSorted(([ax, ay], [bx, by]) => ax - bx || ay - by);
  return [...halfHull(sorted), ...halfHull(sorted.reverse())];
}

function halfHull(sorted) {
  const hull = [];
  for (const point of sorted) {
    while (hull.length > 1 && turn(hull.at(-2), hull.at(-1), point) >= 0) hull.pop();
    hull.push(point);
  }
  return hull.slice(0, -1);
}

const turn = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
