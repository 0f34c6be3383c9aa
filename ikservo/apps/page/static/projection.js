// The server's camera, see ikservo/apps/page/picking/projection.py: pixels are CSS pixels from the
// top left corner. A real camera has a lens, see ikservo/apps/page/picking/lens_camera.py and
// ikservo/apps/cameras/camera_model.py.

import { add, column, dot, origin, scale, subtract } from "./geometry.js";

const FAR_PX = 1e5; // limit for points beside the eye, so that drawing works

const PARTS = 8; // segments of a straight line that a lens bends

const clip = (px) => Math.min(Math.max(px, -FAR_PX), FAR_PX);

export class Projection {
  constructor({ pose, scale_px, perspective, near_m, size, lens }) {
    [this.right, this.up, this.back, this.eye] = [column(pose, 0), column(pose, 1), column(pose, 2), origin(pose)];
    this.forward = scale(this.back, -1);
    [this.width, this.height] = size;
    Object.assign(this, { perspective, scalePx: scale_px, nearM: near_m, lens });
  }

  // Returns the depth along the optical axis, metres.
  depth(point) {
    return dot(subtract(point, this.eye), this.forward);
  }

  pixelsPerMetre(depth) {
    return this.perspective ? this.scalePx / Math.max(depth, this.nearM) : this.scalePx;
  }

  // Returns the pixel of a point, metres.
  project(point) {
    const away = subtract(point, this.eye);
    if (this.lens) return this.projectByLens(away);
    const metre = this.pixelsPerMetre(dot(away, this.forward));
    return [clip(this.width / 2 + metre * dot(away, this.right)), clip(this.height / 2 - metre * dot(away, this.up))];
  }

  projectByLens(away) {
    const { focal, centre, distortion: [k1, k2, p1, p2, k3], widest } = this.lens;
    const depth = Math.max(dot(away, this.forward), this.nearM);
    const [flatX, flatY] = [dot(away, this.right) / depth, -dot(away, this.up) / depth];
    const beyond = Math.max(Math.hypot(flatX, flatY) / widest, 1);
    const [x, y] = [flatX / beyond, flatY / beyond];
    const r2 = x * x + y * y;
    const radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
    const bent = [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y];
    return bent.map((along, i) => clip(centre[i] + focal[i] * beyond * along));
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
    const bends = this.lens ? kept.flatMap((a, i) => divide(a, kept[(i + 1) % kept.length])) : kept;
    return bends.map((point) => this.project(point));
  }
}

const divide = (a, b) => Array.from({ length: PARTS }, (_, i) => add(a, subtract(b, a), i / PARTS));
