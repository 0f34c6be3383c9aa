// Ties the page together: what the server says goes to the drawing and the panel, what the person
// does goes to the server.

import { Connection } from "./connection.js";
import { Drawing } from "./drawing.js";
import { $, choices } from "./elements.js";
import { Gamepads } from "./gamepad.js";
import { Panel } from "./panel.js";
import { Pointing } from "./pointing.js";
import { Wizard } from "./wizard.js";

const VIEWS = { side: "Side", top: "Top", front: "Front", orbit: "Orbit", plane: "Plane" };

const canvas = $("drawing");
const drawing = new Drawing(canvas, $("backdrop"));
const key = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
let arm = null;
let view = null;
let scenes = []; // not drawn yet: one a refresh, so that a late one is not missed
window.ikservo = { scene: null, status: null, drawn: 0 }; // for whoever looks on, a test for one

const connection = new Connection(key, {
  arm(message) {
    arm = message;
    view = arm.views.includes(view) ? view : arm.views[0];
    panel.arm(message);
    look();
  },
  scene(message) {
    scenes.push(message);
  },
  status(message) {
    window.ikservo.status = message;
    panel.show(message);
    wizard.show(message.calibration);
  },
  refused(message) { panel.refuse(message); },
  lost(why) {
    scenes = [];
    document.body.dataset.mode = "lost";
    $("live").disabled = true;
    panel.banner(why === "key"
      ? { message: "This page's key is not the one of this session.", hint: "Open the address that `ikservo view` printed." }
      : { message: "The connection is lost; the arm holds.", hint: "Is `ikservo view` still running? Trying again …" });
  },
});
const say = (kind, fields) => connection.say(kind, fields);
const panel = new Panel(say);
const wizard = new Wizard(say);
const pointing = new Pointing(canvas, say);
const gamepads = new Gamepads(say, (words) => { $("gamepad").textContent = words; });
gamepads.hold($("jaws-open"), -1);
gamepads.hold($("jaws-close"), 1);

function look() {
  if (!arm) return;
  drawing.fit();
  const { clientWidth: w, clientHeight: h } = canvas;
  connection.say("look", { w, h, dpr: devicePixelRatio, view });
  choices($("views"), arm.views, view, (name) => { view = name; look(); }, (name) => VIEWS[name]);
}

function frame(now) {
  requestAnimationFrame(frame);
  pointing.flush();
  gamepads.poll(now);
  if (scenes.length) show(scenes.shift());
}

function show(scene) {
  connection.drawn(scene.seq); // said first: the server prepares the next while this is drawn
  drawing.show(scene.backdrop, scene.items);
  canvas.toggleAttribute("data-hover", Boolean(scene.hover));
  canvas.toggleAttribute("data-held", Boolean(scene.held));
  canvas.toggleAttribute("data-picked", Boolean(scene.picked));
  window.ikservo.scene = scene;
  window.ikservo.drawn += 1;
}

// Space and Escape stop, wherever the focus is; a button is pressed with Enter.
addEventListener("keydown", (event) => {
  if (event.key !== " " && event.key !== "Escape") return;
  event.preventDefault();
  event.stopPropagation();
  if (!event.repeat) say("stop");
}, { capture: true });
// N chooses what is behind the thing under the pointer, Shift+N what is before it.
addEventListener("keydown", (event) => {
  const typing = event.target.closest?.("input, select") || event.ctrlKey || event.metaKey || event.altKey;
  if (event.key.toLowerCase() === "n" && !typing) say("behind", { step: event.shiftKey ? -1 : 1 });
});
addEventListener("keyup", (event) => { if (event.key === " ") event.preventDefault(); }, { capture: true });

new ResizeObserver(look).observe(canvas);
const watchRatio = () => {
  matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener("change", () => { look(); watchRatio(); }, { once: true });
};
watchRatio();
requestAnimationFrame(frame);
