// The hand that moves the tool: a phone or a controller tracked by WebXR, or else a phone's gyroscope
// with moving by touch. While the user holds to move, each frame sends the pose of the hand.

import { $, setText, updateChoices } from "./elements.js";
import { HandSession } from "./hand_session.js";
import { fromAngles, heading, multiply, turnAboutZ, yaw } from "./quaternions.js";

const M_PER_PX = 0.0005; // motion of the hand for that of a finger
const SIDES = { behind: 0, right: Math.PI / 2, facing: Math.PI, left: -Math.PI / 2 }; // where the user stands
const SIDE_TEXTS = { behind: "Behind the arm", right: "Right of it", facing: "Facing it", left: "Left of it" };
const BUZZ_MS = 25;
const REST = { position: [0, 0, 0], rotation: [1, 0, 0, 0] };
const FARTHEST_M = 10;
const LATENCY_WEIGHT = 0.1;

export class Hand {
  // gamepads moves the gripper; record() begins or saves an episode; draw(now) draws a frame of the page.
  constructor(send, gamepads, stop, record, draw) {
    Object.assign(this, { send, gamepads, stop, record, draw });
    this.fingers = new Map(); // positions by pointer id: the first one holds, with a second one up is forward
    this.touched = [0, 0, 0]; // displacement by touch, in metres: right, up, forward
    this.sensor = [1, 0, 0, 0]; // orientation of the phone by its gyroscope
    this.hasSensor = false;
    this.side = "behind";
    this.turn = null; // rotation about the vertical from the source's axes to those of the arm, while held
    this.wasHeld = false;
    this.presses = Date.now(); // number of the last press of any source; no other page has the same ones
    this.spent = this.presses; // this press and earlier ones no longer close the clutch
    this.finger = 0; // the press of the first finger; 0 for none
    this.clutch = this.since = 0; // the press that holds, and when it began
    this.limit = "";
    this.failure = ""; // why the last session did not start, until the next press
    this.latency = null;
    this.session = null;
    this.records = false; // whether the button that records is pressed
    $("hand-show").onclick = () => this.open();
    $("hand-close").onclick = () => this.close();
    $("hand-xr").onclick = () => (this.session ? this.session.end() : this.startSession());
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
      this.hasSensor = alpha !== null;
      if (this.hasSensor) this.sensor = multiply(fromAngles(alpha, beta, gamma), yaw((-(screen.orientation?.angle ?? 0) * Math.PI) / 180));
    });
    screen.orientation?.addEventListener("change", () => this.release());
    navigator.xr?.isSessionSupported("immersive-ar").then((can) => { $("hand-xr").hidden = !can; }, () => {});
    this.showSides();
    this.showScale();
    this.showPad();
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
    this.sendPose(REST, false); // prepares the filter
    await globalThis.DeviceOrientationEvent?.requestPermission?.().catch(() => {}); // iPhones ask the user
  }

  close() {
    this.session?.end();
    this.release();
    this.place(false);
  }

  // Opens the clutch at once; presses that have begun do not close it again.
  release() {
    this.fingers.clear();
    this.spent = this.presses;
    this.finger = this.gamepads.handGrip = 0;
    this.wasHeld = false;
    $("hand-hold").toggleAttribute("data-held", false);
    if (this.isOpen()) this.sendPose(REST, false);
  }

  scale() {
    return Number($("hand-scale").value);
  }

  showPad() {
    setText($("hand-xr"), this.session ? "End AR" : "Start AR");
    setText($("hand-hold"), this.session ? "Hold and move the phone" : "Hold and slide ↔ ↕. Second finger: forward and back");
  }

  showScale() {
    setText($("hand-scale-text"), `${this.scale()} ×`);
  }

  showSides() {
    updateChoices($("hand-sides"), Object.keys(SIDES), this.side, (side) => { this.side = side; this.release(); this.showSides(); }, (side) => SIDE_TEXTS[side]);
  }

  async startSession() {
    this.release();
    this.failure = "";
    try {
      this.session = await HandSession.start({
        press: () => { this.presses += 1; return this.presses; },
        frame: (now, source) => this.onSessionFrame(now, source),
        lost: () => this.release(),
        ended: () => { this.session = null; this.release(); this.showPad(); },
      });
      this.showPad();
      if (!this.isOpen()) this.session.end();
    } catch (error) {
      this.failure = `AR cannot start here: ${error.message}`;
      setText($("hand-state"), this.failure);
    }
  }

  onDown(event) {
    event.preventDefault();
    $("hand-hold").setPointerCapture(event.pointerId);
    if (!this.fingers.size) this.finger = this.presses += 1;
    this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  onMove(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    if (!event.buttons) { this.onUp(event); return; }
    const [right, down] = [event.clientX - before[0], event.clientY - before[1]];
    const isFirst = event.pointerId === [...this.fingers.keys()][0];
    this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.session) return; // the phone itself moves
    if (isFirst) this.touched[0] += right * M_PER_PX;
    if (!isFirst) this.touched[2] -= down * M_PER_PX;
    else if (this.fingers.size === 1) this.touched[1] -= down * M_PER_PX;
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
    this.hold({ position, rotation: this.sensor }, this.finger, this.forward);
  }

  // source: its pose (null while tracking is lost), the heading of the user, its press, and the pressed buttons.
  onSessionFrame(now, source) {
    if (source.stops) this.stop();
    if (source.records && !this.records) this.record();
    this.records = source.records;
    if (this.isOpen()) {
      this.pulse = source.pulse;
      this.hold(source.pose, source.press ?? this.finger, source.heading);
      this.gamepads.handGrip = source.pose ? source.grip ?? 0 : 0;
    }
    this.draw(now);
  }

  // press: number of the press that holds; 0 for none. At its beginning, "forward" of the user becomes that of
  // the arm, seen from the chosen side.
  hold(pose, press, forward) {
    if (this.wasHeld && (!pose || press !== this.clutch)) this.release();
    let refused = press <= this.spent ? "Let go first, then hold to move" : "";
    if (!this.wasHeld && forward === null) refused ||= "Hold the phone flatter: it points too steeply to know where forward is";
    if (press && refused) setText($("hand-state"), refused);
    if (!pose || !press || refused) return;
    if (!this.wasHeld) {
      Object.assign(this, { wasHeld: true, clutch: press, since: performance.now(), origin: pose.position, turn: SIDES[this.side] - forward, failure: "" });
      $("hand-hold").toggleAttribute("data-held", true);
    }
    const moved = pose.position.map((at, i) => at - this.origin[i]);
    this.sendPose({ position: turnAboutZ(moved, this.turn), rotation: multiply(yaw(this.turn), pose.rotation) }, true);
  }

  sendPose({ position, rotation }, held) {
    const within = (values, most) => values.map((value) => Math.max(-most, Math.min(most, value)));
    const pose = { position: within(position, FARTHEST_M), rotation: within(rotation, 1) };
    this.send("track_hand", { ...pose, held, clutch: this.clutch, scale: this.scale(), stamp: performance.now() });
  }

  // The server's answer, once the arm has had a pose.
  show({ stamp, held, limit }) {
    if (this.wasHeld && !held && stamp >= this.since) this.release(); // the server has opened the clutch
    const took = performance.now() - stamp;
    this.latency = this.latency === null ? took : this.latency + LATENCY_WEIGHT * (took - this.latency);
    if (limit && !this.limit) this.buzz();
    this.limit = limit;
    $("hand-hold").toggleAttribute("data-limit", Boolean(limit));
    const isLive = document.body.dataset.mode === "live";
    setText($("hand-state"), this.failure || `${held ? `Moves with your ${this.session || this.hasSensor ? "hand" : "finger"}` : "Hold to move"}${isLive ? "" : " · only the preview: Live is off"}${limit ? ` · held back: ${limit}` : ""} · ${Math.round(this.latency)} ms`);
  }

  buzz(ms = BUZZ_MS) {
    if (this.pulse) this.pulse(ms);
    else navigator.vibrate?.(ms);
  }
}

