// A SpaceMouse by WebHID: while it is deflected, a virtual hand moves and turns.

import { multiply } from "./quaternions.js";

const MULTI_AXIS = { usagePage: 1, usage: 8 };
const VENDORS = [0x256f, 0x046d]; // 3Dconnexion, and Logitech for older ones
const FULL = 350; // counts at full deflection
const DEAD_ZONE = 0.08;
const SPEED_M_S = 0.15;
const TURN_RAD_S = 1.0;
const SILENT_MS = 300; // a deflected SpaceMouse reports all the time
const LONGEST_S = 0.1; // a longer pause between two frames counts as this
const FIRST_AXIS = { 1: 0, 2: 3 }; // by the number of the report; in some models report 1 has all six axes
const BUTTONS = 3;

export class SpaceMouse {
  constructor() {
    this.axes = [0, 0, 0, 0, 0, 0];
    this.buttons = this.heardAt = this.steppedAt = 0;
    this.position = [0, 0, 0];
    this.rotation = [1, 0, 0, 0];
  }

  // Lets the user choose the device.
  async connect() {
    const filters = VENDORS.map((vendorId) => ({ vendorId, ...MULTI_AXIS }));
    const [device] = await navigator.hid.requestDevice({ filters });
    if (!device) return;
    if (!device.opened) await device.open();
    device.addEventListener("inputreport", ({ reportId, data }) => this.read(reportId, data));
  }

  read(reportId, data) {
    this.heardAt = performance.now();
    if (reportId === BUTTONS) this.buttons = data.getUint8(0);
    const first = FIRST_AXIS[reportId];
    if (first === undefined) return;
    for (let i = 0; first + i < 6 && 2 * i + 1 < data.byteLength; i += 1) {
      const value = Math.max(-1, Math.min(1, data.getInt16(2 * i, true) / FULL));
      this.axes[first + i] = Math.abs(value) < DEAD_ZONE ? 0 : value;
    }
  }

  isDeflected() {
    return performance.now() - this.heardAt < SILENT_MS && this.axes.some(Boolean);
  }

  // 1 closes the gripper, -1 opens it: the left and the right button.
  grip() {
    return Number(Boolean(this.buttons & 1)) - Number(Boolean(this.buttons & 2));
  }

  // Moves the virtual hand until now. Axes of the device: right, back, down; of the hand: forward, left, up.
  step() {
    const now = performance.now();
    const elapsed = Math.min((now - this.steppedAt) / 1000, LONGEST_S);
    this.steppedAt = now;
    const [x, y, z, rx, ry, rz] = this.axes;
    this.position = [-y, -x, -z].map((speed, i) => this.position[i] + speed * SPEED_M_S * elapsed);
    const half = [-ry, -rx, -rz].map((speed) => (speed * TURN_RAD_S * elapsed) / 2);
    const turned = multiply([1, ...half], this.rotation);
    const length = Math.hypot(...turned);
    this.rotation = turned.map((part) => part / length);
  }
}
