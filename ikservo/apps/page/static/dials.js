// Ranges of the joints as arcs with a needle, or tracks for prismatic joints.

import { add, cross, dot, length, origin, rotate, scale, subtract } from "./geometry.js";

const RADIUS_PX = 26;
const HUB_PX = 3;
const STEP_RAD = Math.PI / 30;
const EDGE_ON_COSINE = 0.4; // below this an arc is seen edge-on, so its dial is drawn facing the camera

export class Dials {
  constructor({ dials, links }) {
    const axes = new Map(links.map(({ name, axis }) => [name, axis]));
    this.dials = dials.map((dial) => {
      const axis = axes.get(dial.link);
      return { ...dial, axis, side: cross(axis, dial.needle), marks: markRange(dial) };
    });
  }

  // Returns arc, needle and hub of each joint and, if there is a goal, how near the goal is to the
  // limits.
  items(placed, placedGoal, projection, limp = []) {
    return this.dials.flatMap((dial) => {
      const { mount, pose, position } = placed.get(dial.link);
      const positions = [position, placedGoal?.get(dial.link).position ?? position];
      const style = proximity(dial, positions, limp.includes(dial.joint));
      const [pivot, axis] = [origin(mount), rotate(mount, dial.axis)];
      return dial.slides ? trackItems(dial, style, pivot, axis, position, projection)
        : arcItems(dial, style, pivot, axis, pose, position, projection);
    });
  }
}

// The angles of an arc's points; the circle of a continuous joint turns with its needle.
function markRange({ range, slides }) {
  if (slides) return range;
  const [low, high] = range ?? [-Math.PI, Math.PI];
  const steps = Math.max(1, Math.ceil((high - low) / STEP_RAD));
  return Array.from({ length: steps + 1 }, (_, i) => low + ((high - low) * i) / steps);
}

// A joint at its limit is not a fault, nor is a limp joint that sagged past its limit.
function proximity({ range, at, near }, positions, isLimp) {
  if (!range) return "limit";
  const room = Math.min(...positions.flatMap((position) => [position - range[0], range[1] - position]));
  return room < -at && !isLimp ? "red" : room <= near ? "amber" : "limit";
}

function trackItems({ joint, marks }, style, pivot, axis, position, projection) {
  const points = marks.map((mark) => projection.project(add(pivot, axis, mark)));
  return [{ kind: "polyline", style, points, joint }, hubItem(joint, projection.project(add(pivot, axis, position)))];
}

function arcItems({ joint, needle, side, marks, range }, style, pivot, axis, pose, position, projection) {
  const sight = projection.perspective ? subtract(pivot, projection.eye) : projection.forward;
  const edgeOn = Math.abs(dot(axis, sight)) < EDGE_ON_COSINE * length(sight);
  const plane = edgeOn ? [projection.up, projection.right] : [rotate(pose, needle), rotate(pose, side)];
  const radius = RADIUS_PX / projection.pixelsPerMetre(projection.depth(pivot));
  const [first, second] = plane.map((direction) => scale(direction, radius));
  const at = (angle) => projection.project(add(add(pivot, first, Math.cos(angle)), second, Math.sin(angle)));
  const turned = edgeOn ? position : 0; // turns the needle; the plane of the link turns with it
  const shift = range ? turned - position : turned;
  const hub = projection.project(pivot);
  return [
    { kind: "polyline", style, points: marks.map((mark) => at(mark + shift)), joint },
    { kind: "polyline", style: "needle", points: [hub, at(turned)], joint },
    hubItem(joint, hub),
  ];
}

const hubItem = (joint, at) => ({ kind: "circle", style: "hub", at, r: HUB_PX, joint });
