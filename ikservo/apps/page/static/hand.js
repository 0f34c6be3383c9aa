// The hand that moves the tool: a phone or a controller tracked by WebXR, or else a phone's gyroscope
// with moving by touch. While the user holds to move, each frame sends the pose of the hand.

import { $, setText, updateChoices } from "./elements.js";
import { HandSession } from "./hand_session.js";
import { fromAngles, heading, multiply, turnAboutZ, yaw } from "./quaternions.js";

const M_PER_PX = 0.0005; // motion of the hand for that of a finger
const SIDES = { behind: 0, right: Math.PI / 2, facing: Math.PI, left: -Math.PI / 2 }; // where the user stands
const SIDE_TEXTS = { behind: "Behind the arm", right: "Right of it", facing: "Facing it", left: "Left of it" };
const BUZZ_MS = 25;
const LATENCY_WEIGHT = 0.1;

export class Hand {
  // gamepads moves the gripper; draw(now) draws a frame of the page.
  constructor(send, gamepads, stop, draw) {
    Object.assign(this, { send, gamepads, stop, draw });
    this.fingers = new Map(); // positions by pointer id: the first one holds, with a second one up is forward
    this.touched = [0, 0, 0]; // displacement by touch, in metres: right, up, forward
    this.sensor = [1, 0, 0, 0]; // orientation of the phone by its gyroscope
    this.side = "behind";
    this.turn = null; // rotation about the vertical from the source's axes to those of the arm, while held
    this.wasHeld = false;
    this.limit = "";
    this.latency = null;
    this.session = null;
    $("hand-show").onclick = () => this.open();
    $("hand-close").onclick = () => this.close();
    $("hand-xr").onclick = () => this.startSession();
    $("hand-scale").oninput = () => this.showScale();
    gamepads.bindButton($("hand-gripper-open"), -1);
    gamepads.bindButton($("hand-gripper-close"), 1);
    const pad = $("hand-hold");
    pad.addEventListener("pointerdown", (event) => this.onDown(event));
    pad.addEventListener("pointermove", (event) => this.onMove(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) pad.addEventListener(end, (event) => this.onUp(event));
    for (const refused of ["contextmenu", "beforexrselect", "touchstart"]) pad.addEventListener(refused, (event) => event.preventDefault(), { passive: false });
    document.addEventListener("visibilitychange", () => document.hidden && this.release());
    addEventListener("deviceorientation", ({ alpha, beta, gamma }) => {
      if (alpha !== null) this.sensor = fromAngles(alpha, beta, gamma);
    });
    navigator.xr?.isSessionSupported("immersive-ar").then((can) => { $("hand-xr").hidden = !can; }, () => {});
    this.showSides();
    this.showScale();
  }

  isOpen() {
    return !$("hand").hidden;
  }

  place(shown) {
    $("hand").hidden = !shown;
    document.querySelector(".stage").toggleAttribute("data-leader", shown || !$("leader").hidden); // beside the picture
  }

  async open() {
    this.place(true);
    this.sendPose({ position: [0, 0, 0], rotation: [1, 0, 0, 0] }, false); // prepares the filter
    await globalThis.DeviceOrientationEvent?.requestPermission?.().catch(() => {}); // iPhones ask the user
  }

  close() {
    this.session?.end();
    this.release();
    this.flush();
    this.place(false);
  }

  release() {
    this.fingers.clear();
  }

  scale() {
    return Number($("hand-scale").value);
  }

  showScale() {
    setText($("hand-scale-text"), `${this.scale()} ×`);
  }

  showSides() {
    updateChoices($("hand-sides"), Object.keys(SIDES), this.side, (side) => { this.side = side; this.release(); this.showSides(); }, (side) => SIDE_TEXTS[side]);
  }

  async startSession() {
    try {
      this.session = await HandSession.start({
        frame: (now, source) => this.onSessionFrame(now, source),
        ended: () => { this.session = null; this.release(); this.flush(); },
      });
    } catch (error) {
      setText($("hand-state"), `AR cannot start here: ${error.message}`);
    }
  }

  onDown(event) {
    event.preventDefault();
    $("hand-hold").setPointerCapture(event.pointerId);
    this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  onMove(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const [right, down] = [event.clientX - before[0], event.clientY - before[1]];
    this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.session) return; // the phone itself moves
    this.touched[0] += right * M_PER_PX;
    if (this.fingers.size === 1) this.touched[1] -= down * M_PER_PX;
    else if (event.pointerId !== [...this.fingers.keys()][0]) this.touched[2] -= down * M_PER_PX;
  }

  onUp(event) {
    const first = [...this.fingers.keys()][0] === event.pointerId;
    this.fingers.delete(event.pointerId);
    if (first) this.release(); // the finger that holds
  }

  // Called once per frame of the page: without WebXR, sends the pose by touch and gyroscope.
  flush() {
    if (!this.isOpen() || this.session) return;
    if (!this.wasHeld) this.forward = heading(this.sensor);
    const [right, up, ahead] = this.touched;
    const position = turnAboutZ([ahead, -right, up], this.forward);
    this.hold({ position, rotation: this.sensor }, this.fingers.size > 0, this.forward);
  }

  // source: its pose (null while tracking is lost), the heading of the user, and the pressed buttons.
  onSessionFrame(now, source) {
    this.pulse = source.pulse;
    const held = source.pose !== null && (source.held ?? this.fingers.size > 0);
    this.hold(source.pose, held, source.heading);
    if (source.grip !== undefined) this.gamepads.buttonGrip = source.grip;
    if (source.stops) this.stop();
    this.draw(now);
  }

  // At the beginning, "forward" of the user becomes that of the arm, seen from the chosen side.
  hold(pose, held, forward) {
    if (held && !this.wasHeld) this.turn = SIDES[this.side] - forward;
    if (held) this.sendPose({ position: turnAboutZ(pose.position, this.turn), rotation: multiply(yaw(this.turn), pose.rotation) }, true);
    else if (this.wasHeld) this.sendPose({ position: [0, 0, 0], rotation: [1, 0, 0, 0] }, false);
    this.wasHeld = held;
    $("hand-hold").toggleAttribute("data-held", held);
  }

  sendPose({ position, rotation }, held) {
    this.send("track_hand", { position, rotation, held, scale: this.scale(), stamp: performance.now() });
  }

  // The server's answer, once the arm has had a pose.
  show({ stamp, held, limit }) {
    const took = performance.now() - stamp;
    this.latency = this.latency === null ? took : this.latency + LATENCY_WEIGHT * (took - this.latency);
    if (limit && !this.limit) this.buzz();
    this.limit = limit;
    $("hand-hold").toggleAttribute("data-limit", Boolean(limit));
    setText($("hand-state"), `${held ? "Moves with your hand" : "Hold to move"}${limit ? ` · held back: ${limit}` : ""} · ${Math.round(this.latency)} ms`);
  }

  buzz() {
    if (this.pulse) this.pulse(BUZZ_MS);
    else navigator.vibrate?.(BUZZ_MS);
  }
}

