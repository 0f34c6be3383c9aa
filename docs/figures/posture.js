// Figures of one posture: the places of its points, the columns of its Jacobian, and a damped step.

import { addOutput, addSlider, COLOURS, degrees, millimetres, Plane } from "./drawing.js";
import { dampedStep, forward, jacobian, length, minus, times, wrap } from "./planar.js";

const LINKS = [0.22, 0.18, 0.12];
const VIEW = [-0.6, -0.35, 1.2, 0.95];

/** An arm whose links follow the pointer: a drag turns the joint below the end that was pressed. */
function posable(figure, start, draw) {
  const plane = new Plane(figure, VIEW);
  const q = [...start];
  let grabbed = 0;
  const turn = (at) => {
    const [x, y] = minus(at, forward(LINKS, q)[grabbed]);
    const heading = q.slice(0, grabbed).reduce((sum, value) => sum + value, 0);
    q[grabbed] = wrap(Math.atan2(y, x) - heading);
    draw(plane, q);
  };
  plane.onDrag(turn, (at) => {
    const away = forward(LINKS, q).slice(1).map((end) => length(minus(at, end)));
    grabbed = away.indexOf(Math.min(...away));
  });
  return { plane, q };
}

function drawArm(plane, q) {
  plane.clear();
  plane.circle([0, 0], 0.52, COLOURS.help, { dash: "5 4" });
  plane.arm(forward(LINKS, q), COLOURS.arm);
}

export function forwardKinematics(figure) {
  const draw = (plane, q) => {
    drawArm(plane, q);
    const ends = forward(LINKS, q).slice(1);
    ends.forEach((end) => plane.dot(end, COLOURS.hit));
    const place = ([x, y]) => `(${x.toFixed(3)}, ${y.toFixed(3)}) m`;
    output.value = ends
      .map((end, i) => `φ${i + 1} = ${degrees(q[i])}: link ${i + 1} ends at ${place(end)}`)
      .join("\n");
  };
  const { plane, q } = posable(figure, [0.7, 0.5, -0.6], draw);
  const output = addOutput(figure);
  draw(plane, q);
}

const TURN_RAD = (5 * Math.PI) / 180;

export function jacobianColumns(figure) {
  const draw = (plane, q) => {
    drawArm(plane, q);
    const tip = forward(LINKS, q)[LINKS.length];
    const lines = jacobian(LINKS, q).map((column, i) => {
      const turned = forward(LINKS, q.map((value, k) => (k === i ? value + TURN_RAD : value)))[LINKS.length];
      const [tx, ty] = column.map((part) => part * TURN_RAD);
      plane.arrow(tip, [tip[0] + 0.5 * column[0], tip[1] + 0.5 * column[1]], COLOURS.good);
      plane.text([tip[0] + 0.5 * column[0], tip[1] + 0.5 * column[1]], `J${i + 1}`);
      const off = length(minus(turned, [tip[0] + tx, tip[1] + ty]));
      return `J${i + 1} = (${column.map((part) => part.toFixed(3)).join(", ")}) m/rad; `
        + `a turn by 5° moves the tip ${millimetres(length(minus(turned, tip)))}, ${millimetres(off)} beside the prediction`;
    });
    output.value = lines.join("\n");
  };
  const { plane, q } = posable(figure, [0.4, 0.7, 0.5], draw);
  const output = addOutput(figure);
  draw(plane, q);
}

export function damping(figure) {
  let damping_m = 0.05;
  const E = [-0.06, 0];
  const draw = (plane, q) => {
    drawArm(plane, q);
    const J = jacobian(LINKS, q);
    const tip = forward(LINKS, q)[LINKS.length];
    const step = dampedStep(J, E, damping_m);
    const moved = times(J, step);
    plane.cross([tip[0] + E[0], tip[1] + E[1]], COLOURS.target);
    plane.arrow(tip, [tip[0] + moved[0], tip[1] + moved[1]], COLOURS.good);
    const most = Math.max(...step.map(Math.abs));
    output.value = `λ = ${damping_m.toFixed(3)} m/rad: the joint that turns furthest should turn by ${degrees(most)};\n`
      + `by the Jacobian, ${millimetres(length(minus(E, moved)))} of ${millimetres(length(E))} are left then`;
  };
  const { plane, q } = posable(figure, [0.05, 0.06, 0.05], draw);
  addSlider(figure, "damping λ", [0.001, 0.2, damping_m], (value) => {
    damping_m = value;
    draw(plane, q);
  });
  const output = addOutput(figure);
  draw(plane, q);
}
