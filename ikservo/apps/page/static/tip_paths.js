// The path of the tip: planned to its goal, and measured since it began to move.

import { length, subtract } from "./geometry.js";

const APART_M = 0.0005; // distance between two points of the measured path
const REST_MS = 1000; // a motion after a longer rest starts a new path
const MAX_POINTS = 1000;

export class TipPaths {
  constructor(findTip) {
    this.findTip = findTip; // the tip at positions of the joints
    this.measured = [];
    this.planned = [];
    this.goal = this.path = null;
    this.movedAt = -Infinity;
  }

  update({ measured, goal, path }, now) {
    const tip = this.findTip(measured);
    const resting = now - this.movedAt > REST_MS;
    if (resting && goal !== this.goal) this.measured = [];
    const moved = !this.measured.length || length(subtract(tip, this.measured.at(-1))) > APART_M;
    if (moved) {
      this.measured = resting ? [tip] : [...this.measured, tip].slice(-MAX_POINTS);
      this.movedAt = now;
    }
    if (path !== this.path) this.planned = path === null ? [] : path.joints.map(this.findTip);
    Object.assign(this, { goal, path });
  }

  items(projection, inThreeD) {
    const line = (style, points) => ({ kind: "polyline", style, points: points.map((point) => projection.project(point)) });
    const planned = inThreeD ? [] : this.planned; // 3D draws the planned path itself
    return [["planned", planned], ["travelled", this.measured]].filter(([, points]) => points.length > 1).map(([style, points]) => line(style, points));
  }
}
