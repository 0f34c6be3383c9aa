// Chooses how the arm is drawn: in 3D if frames are fast enough, by WebGL if there is a graphics card
// or else on the CPU, and flat otherwise. In Live 3D is not tried, because compiling shaders delays
// heartbeats.

import { $, setAttribute, setText } from "./elements.js";
import { isSame } from "./picture.js";

const WARM_UP_FRAMES = 2; // shaders are compiled in these frames
const TIMED_FRAMES = 5;
const CONTEXT_LOST = "The graphics driver failed";
const NO_WEBGL = "This browser has no 3D graphics";
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i; // names of software renderers
const AFTER_LIVE = "3D begins once Live is off";
const HOPELESS_MS = 1000; // frames as slow as this need no more timing
const BUDGET_MS = 50; // a frame that takes longer makes a drag jerky
const SMOOTH_MS = 12; // a slower frame of the CPU is not drawn with more pixels than the page has
const COARSE_LEVEL = 3; // level of detail at which 3D on the CPU gives up

export class Rendering {
  constructor(canvas, wanted, onChange) {
    this.canvas = canvas;
    this.wanted = wanted; // "3d" or "2d" if the user has chosen
    this.onChange = onChange;
    this.view = this.module = this.renderer = this.graph = this.shapes = this.scene3d = null;
    this.things = []; // things around the arm
    this.shown = {}; // the scene of the last frame
    this.hasCard = hasGraphicsCard();
    this.reason = ""; // why the drawing is flat
    this.live = false; // whether the arm follows this page
    this.tried = false; // whether 3D was tried, and its frames timed
    this.frameMs = null; // median of the timed frames
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
    return this.wanted === "3d" || (this.wanted !== "2d" && !this.reason);
  }

  // The default view: orbit if the arm is drawn in 3D.
  firstView(views) {
    return this.isOn() && views.includes("orbit") ? "orbit" : views[0];
  }

  // Whether 3D is being tried; Live must wait until that ends.
  isTrying() {
    return this.wants3D() && !this.live && !this.tried;
  }

  setLive(live) {
    if (this.live === live) return;
    this.live = live;
    if (!live && this.wants3D() && !this.tried) this.onChange();
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
    if (this.isOn() && this.renderer?.getContext().isContextLost?.()) this.fallBack(CONTEXT_LOST);
    else this.onChange();
  }

  // Returns whether the server should send the shapes of 3D; the first time three.js is loaded meanwhile.
  wantsShapes(view) {
    this.view = view;
    const wants = this.wants3D() && (this.tried || !this.live);
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
      this.fallBack("The 3D view cannot be loaded");
    }
  }

  setShapes(shapes) {
    this.shapes = shapes;
    try {
      this.renderer ??= this.module.createRenderer(this.canvas, this.hasCard);
      this.scene3d = new this.module.Scene3D(this.renderer, this.graph, shapes);
      this.scene3d.markings.setThings(this.things);
    } catch {
      this.fallBack(NO_WEBGL);
    }
    this.frameMs = null;
    this.tried = false;
  }

  setThings(things) {
    this.things = things;
    this.scene3d?.markings.setThings(things);
    this.shown = {};
  }

  fallBack(reason) {
    if (this.reason) return;
    this.reason = reason;
    this.wanted = null;
    this.tried = false;
    this.onChange();
  }

  // Shows a scene in 3D, if 3D is used, with as much detail as time allows.
  show(scene, { pixelRatio, detail }) {
    const on = scene.webgl && this.scene3d !== null && this.isOn();
    this.canvas.hidden = !on;
    $("backdrop").hidden = on;
    if (!on) return;
    this.scene3d.setShadows(detail.shadows);
    // The CPU draws more pixels than the page has if there is time, for smooth edges.
    const ratio = this.hasCard ? pixelRatio : Math.min(detail.maxRatio, this.frameMs && this.frameMs < SMOOTH_MS ? 2 : 1);
    const resized = this.scene3d.fit(this.canvas.clientWidth, this.canvas.clientHeight, ratio);
    if (!resized && isSame(scene, this.shown)) return;
    this.shown = scene;
    this.scene3d.update(scene);
    this.scene3d.render();
    if (this.frameMs === null) this.timeFrames(this.scene3d);
  }

  async timeFrames(scene3d) {
    this.frameMs = 0;
    const times = [];
    scene3d.compile();
    for (let i = 0; i < WARM_UP_FRAMES + TIMED_FRAMES && this.scene3d === scene3d && !this.reason; i++) {
      times.push(await scene3d.timeFrame());
      if (times.at(-1) > HOPELESS_MS && i >= WARM_UP_FRAMES) break;
    }
    if (this.scene3d !== scene3d || this.reason) return;
    this.tried = true;
    const timed = times.slice(WARM_UP_FRAMES).sort((a, b) => a - b);
    this.frameMs = timed[Math.floor(timed.length / 2)];
    if (this.frameMs > BUDGET_MS) this.giveUpSlow(Math.round(this.frameMs), this.frameMs > HOPELESS_MS ? COARSE_LEVEL : 1);
  }

  // Falls back to 2D at a level of detail, see frame_time.js, unless the user has chosen 3D. Returns
  // whether 2D draws from now on.
  giveUpSlow(ms, level) {
    if (this.wanted === "3d" || level < (this.hasCard ? 1 : COARSE_LEVEL)) return false;
    this.fallBack(`A 3D frame takes ${ms} ms here`);
    return true;
  }

  showControls() {
    $("rendering").hidden = this.view !== "orbit";
    $("handles").hidden = !this.wants3D();
    setAttribute($("handles"), "aria-checked", this.handles);
    setAttribute($("render-3d"), "aria-checked", this.isOn());
    const reason = this.wants3D() && this.live && !this.tried ? AFTER_LIVE : this.reason;
    setText($("render-note"), reason ? `${reason}, so the view is 2D.` : "");
  }
}

// Returns whether WebGL names a renderer that is not software.
function hasGraphicsCard() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) return false;
  const info = context.getExtension("WEBGL_debug_renderer_info");
  const renderer = context.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : context.RENDERER);
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return !SOFTWARE.test(renderer);
}
