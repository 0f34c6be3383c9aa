// Pointers, wheel and keys on the drawing. Moves are gathered: one message a frame at most.

const ARROWS = new Set(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "PageUp", "PageDown"]);
const ORBIT_BUTTONS = new Set([1, 2]);
const NOTCH_PX = 100;

export class Pointing {
  constructor(canvas, say) {
    this.canvas = canvas;
    this.say = say;
    this.waiting = null;
    this.turning = null;
    this.pressed = null;
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
    if (this.pressed !== null || this.turning) return;
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    if (ORBIT_BUTTONS.has(event.button)) {
      this.turning = { id: event.pointerId, ...this.at(event) };
      return;
    }
    this.pressed = event.pointerId;
    this.now(event, "down");
  }

  move(event) {
    if (this.turning?.id === event.pointerId) {
      const { x, y } = this.at(event);
      this.say("orbit", { dx: x - this.turning.x, dy: y - this.turning.y });
      this.turning = { id: event.pointerId, x, y };
      return;
    }
    if (this.pressed !== null && this.pressed !== event.pointerId) return;
    this.waiting = this.message(event, this.pressed === null ? "hover" : "move");
  }

  flush() {
    if (this.waiting) this.say("pointer", this.waiting);
    this.waiting = null;
  }

  end(event, phase) {
    if (this.turning?.id === event.pointerId) this.turning = null;
    if (this.pressed !== event.pointerId) return;
    this.pressed = null;
    this.now(event, phase);
  }

  wheel(event) {
    event.preventDefault();
    const scale = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 34 : 1;
    const notches = Math.max(-20, Math.min(20, (-event.deltaY * scale) / NOTCH_PX));
    if (notches) this.say("wheel", { ...this.at(event), notches, alt: event.altKey });
  }

  key(event) {
    if (!ARROWS.has(event.key)) return;
    event.preventDefault();
    this.say("key", { key: event.key, alt: event.altKey, shift: event.shiftKey });
  }
}
