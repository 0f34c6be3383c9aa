// The server's camera, see ikservo/view/camera.py: pixels are CSS pixels from the top left corner.

import { add, column, dot, origin, scale, subtract } from "./geometry.js";

const FAR_PX = 1e5; // so that drawing works with points beside the eye

const clip = (px) => Math.min(Math.max(px, -FAR_PX), FAR_PX);

export class Projection {
  constructor({ pose, scale_px, perspective, near_m, size }) {
    [this.right, this.up, this.back, this.eye] = [column(pose, 0), column(pose, 1), column(pose, 2), origin(pose)];
    this.forward = scale(this.back, -1);
    [this.width, this.height] = size;
    Object.assign(this, { perspective, scalePx: scale_px, nearM: near_m });
  }

  // Along the optical axis, metres.
  depth(point) {
    return dot(subtract(point, this.eye), this.forward);
  }

  pixelsPerMetre(depth) {
    return this.perspective ? this.scalePx / Math.max(depth, this.nearM) : this.scalePx;
  }

  // Returns the pixel of a point, metres.
  project(point) {
    const away = subtract(point, this.eye);
    const metre = this.pixelsPerMetre(dot(away, this.forward));
    return [clip(this.width / 2 + metre * dot(away, this.right)), clip(this.height / 2 - metre * dot(away, this.up))];
  }

  // Returns the pixels of a line or polygon, clipped `near` metres before a perspective eye.
  projectClipped(points, near) {
    if (!this.perspective) return points.map((point) => this.project(point));
    const depths = points.map((point) => this.depth(point));
    const kept = points.flatMap((a, i) => {
      const j = (i + 1) % points.length;
      const [from, to] = [depths[i], depths[j]];
      const here = from >= near ? [a] : [];
      return (from >= near) === (to >= near) ? here : [...here, add(a, subtract(points[j], a), (near - from) / (to - from))];
    });
    return kept.map((point) => this.project(point));
  }
}
