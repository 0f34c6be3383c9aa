// The methods of the lecture for arms in a plane, as the page explains them (L2 to L12).

export const STEP_RAD = (2 * Math.PI) / 180; // L7: no joint turns further in one step
const EPSILON = 0.05; // L8: smaller singular values, as a share of the largest, count as zero

export const minus = (a, b) => [a[0] - b[0], a[1] - b[1]];
export const length = (v) => Math.hypot(v[0], v[1]);
export const wrap = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));

/** L2: the points of an arm from base to tip; angles are relative, in radians. */
export function forward(links, q) {
  const points = [[0, 0]];
  let heading = 0;
  links.forEach((link, i) => {
    heading += q[i];
    const [x, y] = points[i];
    points.push([x + link * Math.cos(heading), y + link * Math.sin(heading)]);
  });
  return points;
}

/** L6: column i is axis x (tip - pivot). */
export function jacobian(links, q) {
  const points = forward(links, q);
  const tip = points[points.length - 1];
  return q.map((_, i) => [-(tip[1] - points[i][1]), tip[0] - points[i][0]]);
}

/** L3: both elbows of two links, or the aligned arm that comes nearest. */
export function solveTwoLinks(l1, l2, [x, y]) {
  const d = Math.hypot(x, y);
  const cosine = (d * d - l1 * l1 - l2 * l2) / (2 * l1 * l2);
  const reached = Math.abs(cosine) <= 1;
  const bend = Math.acos(Math.max(-1, Math.min(1, cosine)));
  const angles = (q2) => [Math.atan2(y, x) - Math.atan2(l2 * Math.sin(q2), l1 + l2 * Math.cos(q2)), q2];
  return { reached, solutions: [angles(bend), angles(-bend)] };
}

/** L4: both elbows of three links whose last link has a direction. */
export function solveThreeLinks([l1, l2, l3], [x, y], direction) {
  const wrist = [x - l3 * Math.cos(direction), y - l3 * Math.sin(direction)];
  const { reached, solutions } = solveTwoLinks(l1, l2, wrist);
  return { reached, wrist, solutions: solutions.map(([a, b]) => [a, b, wrap(direction - a - b)]) };
}

/** The singular values of J (2, n) and the left singular vectors, from the symmetric J J^T. */
export function singularValues(J) {
  let [a, b, c] = [0, 0, 0];
  for (const [jx, jy] of J) [a, b, c] = [a + jx * jx, b + jx * jy, c + jy * jy];
  const turn = 0.5 * Math.atan2(2 * b, a - c);
  const mean = (a + c) / 2, half = Math.hypot((a - c) / 2, b);
  return {
    values: [Math.sqrt(mean + half), Math.sqrt(Math.max(0, mean - half))],
    vectors: [[Math.cos(turn), Math.sin(turn)], [-Math.sin(turn), Math.cos(turn)]],
  };
}

/** L8: J+ E by truncated singular values. */
export function pseudoInverseStep(J, E) {
  const { values, vectors } = singularValues(J);
  const step = J.map(() => 0);
  values.forEach((s, k) => {
    if (s < EPSILON * values[0]) return;
    const [ux, uy] = vectors[k];
    const share = (ux * E[0] + uy * E[1]) / (s * s); // V S^-1 U^T E, with V = J^T U S^-1
    J.forEach(([jx, jy], i) => (step[i] += (jx * ux + jy * uy) * share));
  });
  return step;
}

/** J C for a vector of the joints: how the tip moves. */
export const times = (J, C) => J.reduce(([x, y], [jx, jy], i) => [x + jx * C[i], y + jy * C[i]], [0, 0]);

/** L9: the step of the joints that stay inside +-limit; a joint that would leave is put on it and solved without. */
export function limitedStep(J, E, q, limit) {
  const step = q.map(() => 0);
  let free = q.map((_, i) => i);
  const remaining = () => minus(E, times(J, step.map((value, i) => (free.includes(i) ? 0 : value))));
  while (free.length) {
    const solved = scaled(pseudoInverseStep(free.map((i) => J[i]), remaining()));
    free.forEach((i, k) => (step[i] = solved[k]));
    const leaves = free.filter((i) => Math.abs(q[i] + step[i]) > limit);
    if (!leaves.length) break;
    leaves.forEach((i) => (step[i] = Math.sign(step[i]) * limit - q[i]));
    free = free.filter((i) => !leaves.includes(i));
  }
  return step;
}

/** L10: (J+ J - I) C, a motion of the joints that does not move the tip. */
export function nullSpaceStep(J, C) {
  const seen = pseudoInverseStep(J, times(J, C));
  return seen.map((value, i) => value - C[i]);
}

/** L11: alpha J^T E with the alpha that minimises the linearised error. */
export function transposeStep(J, E) {
  const torque = J.map(([jx, jy]) => jx * E[0] + jy * E[1]);
  const move = times(J, torque);
  const square = move[0] ** 2 + move[1] ** 2;
  const alpha = square > 1e-18 ? (E[0] * move[0] + E[1] * move[1]) / square : 0;
  return { torque, step: torque.map((t) => alpha * t) };
}

/** L13: J^T (J J^T + damping^2 I)^-1 E. */
export function dampedStep(J, E, damping) {
  let [a, b, c] = [damping ** 2, 0, damping ** 2];
  for (const [jx, jy] of J) [a, b, c] = [a + jx * jx, b + jx * jy, c + jy * jy];
  const determinant = a * c - b * b;
  const [fx, fy] = [(c * E[0] - b * E[1]) / determinant, (a * E[1] - b * E[0]) / determinant];
  return J.map(([jx, jy]) => jx * fx + jy * fy);
}

/** L7: the whole step is scaled so that no joint turns further than `most`. */
export function scaled(step, most = STEP_RAD) {
  const largest = Math.max(...step.map(Math.abs), most);
  return step.map((value) => (value * most) / largest);
}

/** L12: the turn of joint i that brings the tip nearest to the target. */
export function ccdTurn(links, q, i, target) {
  const points = forward(links, q);
  const from = minus(points[points.length - 1], points[i]);
  const to = minus(target, points[i]);
  return wrap(Math.atan2(to[1], to[0]) - Math.atan2(from[1], from[0]));
}
