// Chooses how the orbit view is drawn: in 3D by WebGL where frames are fast enough, else on the canvas.

import { $, setAttribute, setText } from "./elements.js";
import { isSame } from "./picture.js";

const WARM_UP_FRAMES = 2; // shaders are compiled meanwhile
const TIMED_FRAMES = 5;
const CONTEXT_LOST = "The graphics driver gave up";
const BUDGET_MS = 50; // a frame that takes longer makes a drag jerky

export class Rendering {
  constructor(canvas, wanted, onChange) {
    this.canvas = canvas;
    this.wanted = wanted; // "3d" or "2d" if the user has chosen
    this.onChange = onChange;
    this.view = this.module = this.renderer = this.graph = this.shapes = this.scene3d = null;
    this.shown = {}; // the scene of the last frame
    this.reason = ""; // why the canvas draws what 3D should
    this.frameMs = null; // of the timed frames, the median
    this.handles = false; // whether the tool has handles
    $("handles").onclick = () => {
      this.handles = !this.handles;
      this.onChange();
    };
    $("render-3d").onclick = () => this.choose(this.isOn() ? "2d" : "3d");
    canvas.addEventListener("webglcontextlost", () => this.fallBack(CONTEXT_LOST));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.scene3d?.setColours();
      this.scene3d?.render();
    });
  }

  isOn() {
    return this.wanted !== "2d" && !this.reason;
  }

  wants3D() {
    return this.view === "orbit" && this.isOn();
  }

  wantsHandles() {
    return this.wants3D() && this.handles;
  }

  // The scene that is drawn in 3D now, or null.
  drawn() {
    return this.canvas.hidden ? null : this.scene3d;
  }

  choose(wanted) {
    this.wanted = wanted;
    this.reason = "";
    if (this.isOn() && this.shapes && !this.scene3d) this.setShapes(this.shapes);
    if (this.isOn() && this.renderer?.getContext().isContextLost()) this.fallBack(CONTEXT_LOST);
    else this.onChange();
  }

  // Returns whether the server should send the shapes of 3D; the first time three.js is loaded meanwhile.
  wantsShapes(view) {
    this.view = view;
    const wants = this.wants3D();
    if (wants && !this.module) this.load();
    this.showControls();
    return wants && Boolean(this.module?.Scene3D);
  }

  async load() {
    this.module = {};
    try {
      this.module = await import("./scene3d.js");
      this.onChange();
    } catch {
      this.module = null;
      this.fallBack("3D cannot be loaded");
    }
  }

  setShapes(shapes) {
    this.shapes = shapes;
    try {
      this.renderer ??= this.module.createRenderer(this.canvas);
      this.scene3d = new this.module.Scene3D(this.renderer, this.graph, shapes);
    } catch {
      this.fallBack("This browser has no WebGL");
    }
    this.frameMs = null;
  }

  fallBack(reason) {
    if (this.reason) return;
    this.reason = reason;
    this.wanted = null;
    this.onChange();
  }

  // Shows a scene in 3D, if that is how it is drawn.
  show(scene) {
    const on = scene.webgl && this.scene3d !== null && this.isOn();
    this.canvas.hidden = !on;
    $("backdrop").hidden = on;
    if (!on) return;
    const resized = this.scene3d.fit(this.canvas.clientWidth, this.canvas.clientHeight, devicePixelRatio);
    if (!resized && isSame(scene, this.shown)) return;
    this.shown = scene;
    this.scene3d.update(scene);
    this.scene3d.render();
    if (this.frameMs === null) this.timeFrames(this.scene3d);
  }

  async timeFrames(scene3d) {
    this.frameMs = 0;
    const times = [];
    for (let i = 0; i < WARM_UP_FRAMES + TIMED_FRAMES && this.scene3d === scene3d && !this.reason; i++) {
      times.push(await scene3d.timeFrame());
    }
    if (this.scene3d !== scene3d || this.reason) return;
    this.frameMs = times.slice(WARM_UP_FRAMES).sort((a, b) => a - b)[Math.floor(TIMED_FRAMES / 2)];
    if (this.frameMs > BUDGET_MS && this.wanted !== "3d") this.fallBack(`3D takes ${Math.round(this.frameMs)} ms a frame here`);
  }

  showControls() {
    $("rendering").hidden = this.view !== "orbit";
    $("handles").hidden = !this.wants3D();
    setAttribute($("handles"), "aria-checked", this.handles);
    setAttribute($("render-3d"), "aria-checked", this.isOn());
    setText($("render-note"), this.reason ? `${this.reason}: drawn in 2D.` : "");
  }
}
