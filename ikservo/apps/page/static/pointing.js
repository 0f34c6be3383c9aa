// Pointers, wheel and keys on the drawing. Moves are combined: at most one message per frame.

const ARROWS = new Set(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "PageUp", "PageDown"]);
const ORBIT_BUTTONS = new Set([1, 2]);
const NOTCH_PX = 100;
const PINCH_PX = 300; // scale of wheel events with Ctrl: touch pads report a pinch as these
const SLOP_PX = 8; // a finger that has moved less may still become the first of two
const ZOOM = { min: 0.2, max: 5 };

export class PointerInput {
  // overLink() tells whether the wheel turns a joint instead of zooming.
  constructor(canvas, send, overLink) {
    this.overLink = overLink;
    this.canvas = canvas;
    this.send = send;
    this.pendingMove = null;
    this.orbiting = null; // the pointer that moves the view
    this.pressed = null;
    this.pressedAt = null;
    this.pendingDown = null; // message of a finger that has neither moved nor lifted yet
    this.fingers = null; // positions of two fingers by pointer id: they move the view
    this.pendingOrbit = null;
    this.take = null; // called with the position of the next press, instead of starting a gesture
    canvas.addEventListener("pointerdown", (event) => this.onDown(event));
    canvas.addEventListener("pointermove", (event) => this.onMove(event));
    canvas.addEventListener("pointerup", (event) => this.onEnd(event, "up"));
    canvas.addEventListener("pointercancel", (event) => this.onEnd(event, "cancel"));
    canvas.addEventListener("pointerleave", (event) => this.pressed === null && this.sendNow(event, "leave"));
    canvas.addEventListener("wheel", (event) => this.onWheel(event), { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("keydown", (event) => this.onKey(event));
  }

  position(event) {
    const box = this.canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  makeMessage(event, phase) {
    return {
      phase, ...this.position(event), button: Math.max(0, event.button), pointer: event.pointerId,
      touch: event.pointerType === "touch", shift: event.shiftKey, alt: event.altKey,
    };
  }

  sendNow(event, phase) {
    this.flush();
    this.send("pointer", this.makeMessage(event, phase));
  }

  onDown(event) {
    if (event.pointerType === "touch" && this.pressed !== null && !this.fingers) return this.startPinch(event);
    if (this.pressed !== null || this.orbiting || this.fingers) return;
    this.canvas.focus({ preventScroll: true });
    if (this.take && event.button === 0) {
      this.take(this.position(event));
      return;
    }
    this.canvas.setPointerCapture(event.pointerId);
    if (ORBIT_BUTTONS.has(event.button)) {
      this.orbiting = { id: event.pointerId, ...this.position(event) };
      return;
    }
    this.pressed = event.pointerId;
    this.pressedAt = this.position(event);
    if (event.pointerType === "touch") this.pendingDown = this.makeMessage(event, "down");
    else this.sendNow(event, "down");
  }

  sendPendingDown() {
    if (this.pendingDown) this.send("pointer", this.pendingDown);
    this.pendingDown = null;
  }

  // A second finger cancels the gesture of the first one; both move the view.
  startPinch(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.fingers = new Map([[this.pressed, this.pressedAt], [event.pointerId, this.position(event)]]);
    this.pendingMove = null;
    if (!this.pendingDown) this.send("pointer", { ...this.makeMessage(event, "cancel"), pointer: this.pressed });
    this.pressed = this.pendingDown = null;
  }

  pinchState() {
    const [a, b] = [...this.fingers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, distance: Math.max(1, Math.hypot(a.x - b.x, a.y - b.y)) };
  }

  addOrbit(dx, dy, zoom = 1, at = null) {
    const { dx: x, dy: y, zoom: z } = this.pendingOrbit ?? { dx: 0, dy: 0, zoom: 1 };
    this.pendingOrbit = { dx: x + dx, dy: y + dy, zoom: Math.max(ZOOM.min, Math.min(ZOOM.max, z * zoom)), at };
  }

  onMove(event) {
    if (this.orbiting?.id === event.pointerId) {
      const { x, y } = this.position(event);
      this.addOrbit(x - this.orbiting.x, y - this.orbiting.y);
      this.orbiting = { id: event.pointerId, x, y };
      return;
    }
    if (this.fingers) {
      if (!this.fingers.has(event.pointerId)) return;
      const before = this.pinchState();
      this.fingers.set(event.pointerId, this.position(event));
      const now = this.pinchState();
      this.addOrbit(now.x - before.x, now.y - before.y, now.distance / before.distance, [now.x, now.y]);
      return;
    }
    if (this.pressed !== null && this.pressed !== event.pointerId) return;
    if (this.pendingDown) {
      const { x, y } = this.position(event);
      if (Math.hypot(x - this.pendingDown.x, y - this.pendingDown.y) < SLOP_PX) return;
      this.sendPendingDown();
    }
    if (this.pressed !== null) this.pressedAt = this.position(event);
    this.pendingMove = this.makeMessage(event, this.pressed === null ? "hover" : "move");
  }

  flush() {
    if (this.pendingMove) this.send("pointer", this.pendingMove);
    if (this.pendingOrbit) this.send("orbit_camera", this.pendingOrbit);
    this.pendingMove = this.pendingOrbit = null;
  }

  onEnd(event, phase) {
    if (this.fingers?.has(event.pointerId)) this.fingers = null;
    if (this.orbiting?.id === event.pointerId) this.orbiting = null;
    if (this.pressed !== event.pointerId) return;
    this.pressed = null;
    const neverStarted = phase === "cancel" && this.pendingDown;
    if (phase === "up") this.sendPendingDown();
    this.pendingDown = null;
    if (!neverStarted) this.sendNow(event, phase);
  }

  onWheel(event) {
    event.preventDefault();
    const scale = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 34 : 1;
    if (event.ctrlKey || !this.overLink()) {
      const { x, y } = this.position(event);
      this.addOrbit(0, 0, Math.exp((-event.deltaY * scale) / PINCH_PX), [x, y]);
      return;
    }
    const notches = Math.max(-20, Math.min(20, (-event.deltaY * scale) / NOTCH_PX));
    if (notches) this.send("wheel", { ...this.position(event), notches, alt: event.altKey });
  }

  onKey(event) {
    if (!ARROWS.has(event.key)) return;
    event.preventDefault();
    this.send("key", { key: event.key, alt: event.altKey, shift: event.shiftKey });
  }
}
