// Pointers on the handles of the tool, before the drawing sees them; one message per frame.

export class HandleInput {
  // find() returns the scene with the handles, or null without one.
  constructor(stage, canvas, find, send) {
    Object.assign(this, { canvas, find, send });
    this.pointer = null; // the pointer that holds a handle
    this.pending = null;
    this.hovering = null; // last position of the pointer, evaluated once per frame
    const listen = (name, handle) => stage.addEventListener(name, (event) => event.target === canvas && handle(event), { capture: true });
    listen("pointerdown", (event) => this.onDown(event));
    listen("pointermove", (event) => this.onMove(event));
    listen("pointerup", (event) => this.onEnd(event, "up"));
    listen("pointercancel", (event) => this.onEnd(event, "cancel"));
  }

  place(event) {
    const box = this.canvas.getBoundingClientRect();
    return { x: (2 * (event.clientX - box.left)) / box.width - 1, y: 1 - (2 * (event.clientY - box.top)) / box.height };
  }

  onDown(event) {
    if (this.pointer !== null) return event.stopPropagation();
    if (event.button !== 0 || event.shiftKey || !this.find()?.handles.press(this.place(event))) return;
    event.stopPropagation();
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    this.pointer = event.pointerId;
    this.send("drag_tool", { phase: "down" });
  }

  onMove(event) {
    this.hovering = this.pointer === null && event.buttons === 0 ? this.place(event) : null;
    if (this.pointer === null) return;
    event.stopPropagation();
    if (event.pointerId === this.pointer) this.pending = this.place(event);
  }

  onEnd(event, phase) {
    if (event.pointerId !== this.pointer) return;
    event.stopPropagation();
    this.flush();
    this.pointer = null;
    this.find()?.handles.release();
    this.send("drag_tool", { phase });
  }

  flush() {
    const scene = this.find();
    const { pending, hovering } = this;
    this.pending = this.hovering = null;
    if (!scene) return;
    if (pending && scene.handles.held) {
      this.send("drag_tool", { phase: "move", ...scene.handles.drag(pending) });
      scene.render();
    }
    if (hovering && scene.handles.hover(hovering)) scene.render();
    this.canvas.toggleAttribute("data-handle", scene.handles.isMarked());
  }
}
