// Figures of the closed forms: two and three links in a plane.

import { addOutput, addSlider, COLOURS, degrees, millimetres, Plane } from "./drawing.js";
import { forward, length, minus, solveThreeLinks, solveTwoLinks } from "./planar.js";

export function twoLinks(figure) {
  const links = [0.3, 0.2];
  const plane = new Plane(figure, [-0.55, -0.35, 1.1, 0.9]);
  const output = addOutput(figure);
  const draw = (target) => {
    const { reached, solutions } = solveTwoLinks(...links, target);
    plane.clear();
    plane.circle([0, 0], 0.5, COLOURS.help, { dash: "5 4" });
    plane.circle([0, 0], 0.1, COLOURS.help, { dash: "5 4" });
    if (reached) plane.arm(forward(links, solutions[1]), COLOURS.other, { dash: "2 10" });
    const points = forward(links, solutions[0]);
    plane.arm(points, COLOURS.arm);
    plane.cross(target, COLOURS.target);
    const away = length(minus(target, points[2]));
    const angles = (q) => `φ1 = ${degrees(q[0])}, φ2 = ${degrees(q[1])}`;
    output.value = reached
      ? `two solutions\n  solid   ${angles(solutions[0])}\n  dotted  ${angles(solutions[1])}`
      : `unreachable: outside the ring from 0.1 m to 0.5 m\n  nearest point ${millimetres(away)} away, ${angles(solutions[0])}`;
  };
  plane.onDrag(draw);
  draw([0.25, 0.25]);
}

const STEPS = 240;

/** The parts of the circle of wrist centres that the first two links reach, as lists of points. */
function reachableArcs(links, target) {
  const arcs = [];
  let arc = [];
  for (let k = 0; k <= STEPS; k++) {
    const { reached, wrist } = solveThreeLinks(links, target, (2 * Math.PI * k) / STEPS);
    if (reached) arc.push(wrist);
    else if (arc.length) arcs.push(arc.splice(0));
  }
  return arc.length ? [...arcs, arc] : arcs;
}

export function threeLinks(figure) {
  const links = [0.3, 0.2, 0.12];
  let target = [0.3, 0.25], direction = 0.2;
  const plane = new Plane(figure, [-0.65, -0.4, 1.3, 1.05]);
  const draw = () => {
    const { reached, wrist, solutions } = solveThreeLinks(links, target, direction);
    const arcs = reachableArcs(links, target);
    plane.clear();
    plane.circle([0, 0], 0.5, COLOURS.help, { dash: "5 4" });
    plane.circle([0, 0], 0.1, COLOURS.help, { dash: "5 4" });
    plane.circle(target, links[2], COLOURS.target);
    arcs.forEach((arc) => plane.line(arc, COLOURS.good, 5));
    if (reached) plane.arm(forward(links, solutions[1]), COLOURS.other, { dash: "2 10" });
    if (reached) plane.arm(forward(links, solutions[0]), COLOURS.arm);
    plane.dot(wrist, reached ? COLOURS.good : COLOURS.target);
    plane.cross(target, COLOURS.target);
    const share = (100 * arcs.flat().length) / (STEPS + 1);
    output.value = `direction of the last link ${degrees(direction)}: ${reached ? "two solutions" : "not possible here"}\n`
      + `${share.toFixed(0)} % of all directions are possible at this point (green)`;
  };
  addSlider(figure, "direction of the last link", [-Math.PI, Math.PI, direction], (value) => {
    direction = value;
    draw();
  });
  const output = addOutput(figure);
  plane.onDrag((at) => {
    target = at;
    draw();
  });
  draw();
}
