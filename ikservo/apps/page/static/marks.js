// The tip, the target, and the iterations of a solver method (ikservo/apps/page/dragging/solver_demo.py).

const TIP_PX = 4;
const CROSS_PX = 9;
const NEAREST_PX = 5;
const TRAIL = 10; // number of earlier iterations that are drawn

const line = (style, points) => ({ kind: "polyline", style, points });
const circle = (style, at, r) => ({ kind: "circle", style, at, r });
const cross = (style, at) => ({ kind: "cross", style, at, r: CROSS_PX });

// A green cross; if out of reach, a red one with the nearest point and a line between them.
export function markItems({ marker, refused_pair }, tip, projection) {
  const items = [circle("tip", projection.project(tip), TIP_PX)];
  if (marker === null) return items;
  const [target, nearest] = [marker.target, marker.nearest].map((point) => projection.project(point));
  if (marker.reached) return [...items, cross(refused_pair === null ? "target" : "target_refused", target)];
  return [...items, line("gap", [target, nearest]), circle("nearest", nearest, NEAREST_PX), cross("target_far", target)];
}

// The arm at an iteration over earlier ones, the path of its tip, and the target.
export function traceItems({ trace, trace_step: step }, projection) {
  if (trace === null) return [];
  const arms = trace.lines.slice(0, step + 1).map((points) => points.map((point) => projection.project(point)));
  const [target, arm, tip] = [projection.project(trace.target), arms.at(-1), arms.at(-1).at(-1)];
  const every = Math.max(1, Math.floor(arms.length / TRAIL));
  const failed = step === trace.lines.length - 1 && !trace.reached;
  return [
    ...arms.filter((_, i) => i % every === 0).map((points) => line("iteration", points)),
    line("trace", arms.map((points) => points.at(-1))),
    line("gap", [tip, target]),
    line("iterate", arm),
    ...arm.slice(0, -1).map((joint) => circle("joint", joint, TIP_PX)),
    circle("tip", tip, TIP_PX),
    cross(failed ? "target_far" : "target", target),
  ];
}
