// Handles on the tool in 3D: arrows that shift the tool and rings that turn it, as far as the arm
// can.

import { Group, Matrix4, Quaternion, TransformControls } from "./three.min.js";

const ARROWS_SIZE = 0.65;
const RINGS_SIZE = 0.95; // outside the arrows

export class Handles {
  constructor(camera, { moves, turns }) {
    this.tool = new Group(); // moved by the controls; its axes are those of the rings
    this.arrows = new TransformControls(camera);
    this.arrows.setSize(ARROWS_SIZE);
    this.rings = new TransformControls(camera);
    this.rings.setMode("rotate");
    this.rings.setSpace("local");
    this.rings.setSize(RINGS_SIZE);
    const [x, y, z] = moves;
    Object.assign(this.arrows, { showX: x, showY: y, showZ: z });
    Object.assign(this.rings, { showX: turns > 0, showY: turns > 1, showZ: turns > 2, showE: false, showXYZE: false });
    this.root = new Group();
    this.root.add(this.tool);
    for (const controls of [this.arrows, this.rings]) {
      controls.attach(this.tool);
      this.root.add(controls.getHelper());
    }
    this.held = null; // the controls of a drag
    this.start = { position: this.tool.position.clone(), quaternion: new Quaternion() };
  }

  // Places the handles at the tip (a vector) with axes (9 numbers, row by row); null hides them.
  show(tip, axes) {
    this.root.visible = axes !== null;
    if (axes === null || this.held) return;
    const [a, b, c, d, e, f, g, h, i] = axes;
    this.tool.position.copy(tip);
    this.tool.quaternion.setFromRotationMatrix(new Matrix4().set(a, b, c, 0, d, e, f, 0, g, h, i, 0, 0, 0, 0, 1));
  }

  // Pointers are { x, y } from -1 to 1. Returns whether another handle is under it.
  hover({ x, y }) {
    const before = [this.arrows.axis, this.rings.axis];
    if (!this.root.visible) this.leave();
    else {
      this.arrows.pointerHover({ x, y, button: -1 });
      if (this.arrows.axis) this.rings.axis = null;
      else this.rings.pointerHover({ x, y, button: -1 });
    }
    return before[0] !== this.arrows.axis || before[1] !== this.rings.axis;
  }

  isMarked() {
    return Boolean(this.arrows.axis || this.rings.axis);
  }

  leave() {
    this.arrows.axis = this.rings.axis = null;
  }

  // Returns whether a handle was there.
  press({ x, y }) {
    this.hover({ x, y });
    const controls = [this.arrows, this.rings].find((each) => each.axis);
    if (!controls) return false;
    this.root.updateMatrixWorld(true); // the plane in which the pointer is followed depends on the axis
    this.start.position.copy(this.tool.position);
    this.start.quaternion.copy(this.tool.quaternion);
    controls.pointerDown({ x, y, button: 0 });
    this.held = controls.dragging ? controls : null;
    return this.held !== null;
  }

  // Returns the shift [m] and the rotation vector [rad] since the press.
  drag({ x, y }) {
    this.held.pointerMove({ x, y, button: -1 });
    const shift = this.tool.position.clone().sub(this.start.position).toArray();
    const turned = this.tool.quaternion.clone().multiply(this.start.quaternion.clone().invert()).normalize();
    const half = Math.acos(Math.min(1, Math.max(-1, turned.w)));
    const scale = half < 1e-9 ? 2 : (half > Math.PI / 2 ? 2 * (half - Math.PI) : 2 * half) / Math.sin(half);
    return { shift, turn: [turned.x * scale, turned.y * scale, turned.z * scale] };
  }

  release() {
    this.held?.pointerUp({ x: 0, y: 0, button: 0 });
    this.held = null;
    this.leave();
  }
}
