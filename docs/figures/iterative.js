// Figures of the iterative methods: pseudo-inverse, joint limits, null space, transpose, CCD.

import { addButton, addOutput, addSlider, COLOURS, degrees, millimetres, Plane } from "./drawing.js";
import {
  ccdTurn, forward, jacobian, length, limitedStep, minus, nullSpaceStep, pseudoInverseStep, scaled, singularValues,
  transposeStep,
} from "./planar.js";

const LINKS = [0.2, 0.18, 0.14, 0.1];
const START = [0.6, 0.5, 0.4, 0.3];
const REACHED_M = 1e-4;
const MOST_STEPS = 400;

/** An arm, a target and a trace: what the figures share. */
class Iteration {
  constructor(figure, step) {
    this.figure = figure;
    this.plane = new Plane(figure, [-0.45, -0.25, 1.1, 0.85]);
    this.step = step;
    this.target = [0.1, 0.42];
    this.restart();
  }

  restart() {
    this.q = [...START];
    this.steps = 0;
    this.trace = [this.tip];
  }

  get points() {
    return forward(LINKS, this.q);
  }

  get tip() {
    return this.points[LINKS.length];
  }

  get error() {
    return minus(this.target, this.tip);
  }

  get isFinished() {
    return length(this.error) < REACHED_M || this.steps >= MOST_STEPS;
  }

  advance() {
    if (this.isFinished) return;
    this.q = this.step(this);
    this.steps += 1;
    this.trace.push(this.tip);
  }

  runOut() {
    while (!this.isFinished) this.advance();
  }

  drawArm() {
    this.plane.clear();
    this.plane.circle([0, 0], 0.62, COLOURS.help, { dash: "5 4" });
    this.plane.line(this.trace, COLOURS.hit, 1.5);
    this.plane.arm(this.points, COLOURS.arm);
    this.plane.cross(this.target, COLOURS.target);
  }

  get summary() {
    return `step ${this.steps}, error ${millimetres(length(this.error))}`;
  }

  /** Add the buttons, and let a drag set the target. */
  connect(draw) {
    const then = (act) => () => {
      act();
      draw();
    };
    addButton(this.figure, "Step", then(() => this.advance()));
    addButton(this.figure, "10 steps", then(() => { for (let k = 0; k < 10; k++) this.advance(); }));
    addButton(this.figure, "To the end", then(() => this.runOut()));
    addButton(this.figure, "Start again", then(() => this.restart()));
    this.output = addOutput(this.figure);
    this.plane.onDrag((at) => {
      this.target = at;
      this.steps = 0;
      this.trace = [this.tip];
      draw();
    });
    draw();
  }
}

const plus = (q, step) => q.map((value, i) => value + step[i]);

export function pseudoInverse(figure) {
  const run = new Iteration(figure, ({ q, error }) => plus(q, scaled(pseudoInverseStep(jacobian(LINKS, q), error))));
  run.connect(() => {
    run.drawArm();
    const { values, vectors } = singularValues(jacobian(LINKS, run.q));
    const [x, y] = run.tip;
    values.forEach((s, k) => {
      const [ux, uy] = vectors[k].map((part) => part * s * 0.35);
      run.plane.arrow([x, y], [x + ux, y + uy], COLOURS.good);
    });
    run.output.value = `${run.summary}\nsingular values ${values.map((s) => s.toFixed(3)).join(" and ")} m/rad (green: fast and slow direction of the tip)`;
  });
}

export function jointLimits(figure) {
  let limit = 0.9;
  const run = new Iteration(figure, ({ q, error }) => plus(q, limitedStep(jacobian(LINKS, q), error, q, limit)));
  const draw = () => {
    run.drawArm();
    const held = run.q.flatMap((value, i) => (Math.abs(value) > limit - 1e-9 ? [i] : []));
    held.forEach((i) => run.plane.dot(run.points[i], COLOURS.target, 7));
    const names = held.map((i) => i + 1).join(", ");
    run.output.value = `${run.summary}\njoints ${run.q.map(degrees).join(", ")}; at a limit (red): ${names || "none"}`;
  };
  addSlider(figure, "limit of each joint", [0.65, 1.5, limit], (value) => {
    limit = value;
    run.restart();
    draw();
  });
  run.connect(draw);
}

export function nullSpace(figure) {
  let preferred = 0.9;
  const step = ({ q, error }) => {
    const J = jacobian(LINKS, q);
    const C = q.map((value, i) => (i ? 0.3 * (value - preferred) : 0));
    return plus(q, scaled(plus(pseudoInverseStep(J, error), nullSpaceStep(J, C))));
  };
  const run = new Iteration(figure, step);
  run.target = [0.3, 0.3];
  const output = () => `joints ${run.q.map(degrees).join(", ")}\npreferred for the last three: ${degrees(preferred)}; tip ${millimetres(length(run.error))} from the target`;
  const draw = () => {
    for (let k = 0; k < 300; k++) run.q = step(run);
    run.trace = [];
    run.drawArm();
    text.value = output();
  };
  addSlider(figure, "preferred bend", [-1.5, 1.5, preferred], (value) => {
    preferred = value;
    draw();
  });
  const text = addOutput(figure);
  run.plane.onDrag((at) => {
    run.target = at;
    draw();
  });
  draw();
}

export function transpose(figure) {
  const run = new Iteration(figure, ({ q, error }) => plus(q, scaled(transposeStep(jacobian(LINKS, q), error).step)));
  run.connect(() => {
    run.drawArm();
    run.plane.arrow(run.tip, run.target, COLOURS.target);
    const { torque } = transposeStep(jacobian(LINKS, run.q), run.error);
    run.output.value = `${run.summary}\ntorques JᵀE: ${torque.map((t) => t.toFixed(4)).join(", ")}`;
  });
}

export function ccd(figure) {
  const joint = (steps) => LINKS.length - 1 - (steps % LINKS.length); // from the tip to the base
  const run = new Iteration(figure, ({ q, steps, target }) => {
    const i = joint(steps);
    return q.map((value, k) => (k === i ? value + ccdTurn(LINKS, q, i, target) : value));
  });
  run.connect(() => {
    run.drawArm();
    const i = joint(run.steps);
    const pivot = run.points[i];
    run.plane.line([pivot, run.tip], COLOURS.help, 1, "4 4");
    run.plane.line([pivot, run.target], COLOURS.target, 1, "4 4");
    run.plane.dot(pivot, COLOURS.hit, 7);
    const turn = ccdTurn(LINKS, run.q, i, run.target);
    run.output.value = `${run.summary}\nnext: joint ${i + 1} turns by ${degrees(turn)}, so that the grey line falls on the red one`;
  });
}
