// Pointers, wheel and keys on the drawing. Moves are gathered: one message a frame at most.

const ARROWS = new Set(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "PageUp", "PageDown"]);
const ORBIT_BUTTONS = new Set([1, 2]);
const NOTCH_PX = 100;
const PINCH_PX = 300; // of a wheel with Ctrl, which is what touch pads make of a pinch
const SLOP_PX = 8; // a finger that moves less has not decided yet whether a second one comes
const ZOOM = { least: 0.2, most: 5 };

export class Pointing {
  constructor(canvas, say) {
    this.canvas = canvas;
    this.say = say;
    this.waiting = null;
    this.turning = null;
    this.pressed = null;
    this.pressedAt = null;
    this.undecided = null; // what a finger would say, before it moves or lifts
    this.fingers = null; // two of them, by id: they move the view
    this.orbit = null;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.end(event, "up"));
    canvas.addEventListener("pointercancel", (event) => this.end(event, "cancel"));
    canvas.addEventListener("pointerleave", (event) => this.pressed === null && this.now(event, "leave"));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  at(event) {
    const box = this.canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  message(event, phase) {
    return {
      phase, ...this.at(event), button: Math.max(0, event.button), pointer: event.pointerId,
      touch: event.pointerType === "touch", shift: event.shiftKey, alt: event.altKey,
    };
  }

  now(event, phase) {
    this.flush();
    this.say("pointer", this.message(event, phase));
  }

  down(event) {
    if (event.pointerType === "touch" && this.pressed !== null && !this.fingers) return this.pinch(event);
    if (this.pressed !== null || this.turning || this.fingers) return;
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    if (ORBIT_BUTTONS.has(event.button)) {
      this.turning = { id: event.pointerId, ...this.at(event) };
      return;
    }
    this.pressed = event.pointerId;
    this.pressedAt = this.at(event);
    if (event.pointerType === "touch") this.undecided = this.message(event, "down");
    else this.now(event, "down");
  }

  decide() {
    if (this.undecided) this.say("pointer", this.undecided);
    this.undecided = null;
  }

  // A second finger: what the first one began is taken back, and both move the view.
  pinch(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.fingers = new Map([[this.pressed, this.pressedAt], [event.pointerId, this.at(event)]]);
    this.waiting = null;
    if (!this.undecided) this.say("pointer", { ...this.message(event, "cancel"), pointer: this.pressed });
    this.pressed = this.undecided = null;
  }

  spread() {
    const [a, b] = [...this.fingers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.max(1, Math.hypot(a.x - b.x, a.y - b.y)) };
  }

  look(dx, dy, zoom = 1) {
    const { dx: x, dy: y, zoom: z } = this.orbit ?? { dx: 0, dy: 0, zoom: 1 };
    this.orbit = { dx: x + dx, dy: y + dy, zoom: Math.max(ZOOM.least, Math.min(ZOOM.most, z * zoom)) };
  }

  move(event) {
    if (this.turning?.id === event.pointerId) {
      const { x, y } = this.at(event);
      this.look(x - this.turning.x, y - this.turning.y);
      this.turning = { id: event.pointerId, x, y };
      return;
    }
    if (this.fingers) {
      if (!this.fingers.has(event.pointerId)) return;
      const before = this.spread();
      this.fingers.set(event.pointerId, this.at(event));
      const now = this.spread();
      this.look(now.x - before.x, now.y - before.y, now.apart / before.apart);
      return;
    }
    if (this.pressed !== null && this.pressed !== event.pointerId) return;
    if (this.undecided) {
      const { x, y } = this.at(event);
      if (Math.hypot(x - this.undecided.x, y - this.undecided.y) < SLOP_PX) return;
      this.decide();
    }
    if (this.pressed !== null) this.pressedAt = this.at(event);
    this.waiting = this.message(event, this.pressed === null ? "hover" : "move");
  }

  flush() {
    if (this.waiting) this.say("pointer", this.waiting);
    if (this.orbit) this.say("orbit", this.orbit);
    this.waiting = this.orbit = null;
  }

  end(event, phase) {
    if (this.fingers?.has(event.pointerId)) this.fingers = null;
    if (this.turning?.id === event.pointerId) this.turning = null;
    if (this.pressed !== event.pointerId) return;
    this.pressed = null;
    const taken = phase === "cancel" && this.undecided; // it began nothing
    if (phase === "up") this.decide();
    this.undecided = null;
    if (!taken) this.now(event, phase);
  }

  wheel(event) {
    event.preventDefault();
    const scale = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 34 : 1;
    if (event.ctrlKey) {
      this.look(0, 0, Math.exp((-event.deltaY * scale) / PINCH_PX));
      return;
    }
    const notches = Math.max(-20, Math.min(20, (-event.deltaY * scale) / NOTCH_PX));
    if (notches) this.say("wheel", { ...this.at(event), notches, alt: event.altKey });
  }

  key(event) {
    if (!ARROWS.has(event.key)) return;
    event.preventDefault();
    this.say("key", { key: event.key, alt: event.altKey, shift: event.shiftKey });
  }
}
