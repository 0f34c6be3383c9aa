// Connects the parts of the page: server messages update the drawing and the panel, user input is
// sent to the server.

import { Actions, isIdle } from "./actions.js";
import { AppPanels } from "./app_panels.js";
import { Arms } from "./arms.js";
import { Connection } from "./connection.js";
import { Drawing } from "./drawing.js";
import { Episode } from "./episode.js";
import { $, place, setAttribute, setText, updateChoices } from "./elements.js";
import { FrameTime } from "./frame_time.js";
import { Freshness } from "./freshness.js";
import { Gamepads } from "./gamepad.js";
import { Hand } from "./hand.js";
import { HandleInput } from "./handle_input.js";
import { Leader } from "./leader.js";
import { NumberField } from "./number_field.js";
import { Panel } from "./panel.js";
import { Picture } from "./picture.js";
import { PointerInput } from "./pointing.js";
import { Poses } from "./poses.js";
import { Program } from "./program.js";
import { Plots, download } from "./plots.js";
import { Rendering } from "./flat_or_3d.js";
import { Servos } from "./servos.js";
import { StopButton } from "./stop.js";
import { Things } from "./things.js";
import { CalibrationScreens } from "./calibration.js";

const VIEWS = { side: "Side", top: "Top", front: "Front", orbit: "Orbit", plane: "Plane", camera: "Camera" };
const MM = 0.001;

const canvas = $("drawing");
const drawing = new Drawing(canvas, $("backdrop"));
const picture = new Picture();
const options = new URLSearchParams(location.hash.slice(1)); // the options in the page's address
const key = options.get("token") ?? "";
let armInfo = null;
let view = null;
let viewIsChosen = false; // whether the user has chosen the view
let height = 30 * MM; // height above the table for clicks in a camera's picture
let scenes = []; // scenes to draw, one per animation frame, so that late ones are not skipped
window.ikservo = { scene: null, items: [], status: null, drawn: 0 }; // for tests and benchmarks

const connection = new Connection(key, {
  arm_info(message) {
    connection.path = `live/${message.arm}`; // reconnect to this arm after a lost connection
    arms.setShown(message.arm);
    armInfo = message;
    if (!armInfo.views.includes(view)) view = rendering.firstView(armInfo.views);
    panel.setArm(message);
    program.setArm(message);
    plots.setArm(message);
    poses.setArm(message);
    servos.setArm(message);
    $("hand-gripper").hidden = !message.gripper;
    sendViewport();
  },
  program(message) { program.setProgram(message); },
  program_state(message) { program.setState(message); },
  following(message) { leader.showFollowing(message); },
  app_panels(message) { appPanels.show(message); },
  servo(message) { servos.receive(message); },
  hand(message) { hand.show(message); },
  episode(message) { episode.show(message); },
  graph(message) {
    picture.setGraph(message);
    rendering.graph = message;
  },
  shapes(message) { rendering.setShapes(message.links); },
  things(message) {
    const drawn = [...message.things, ...message.links];
    picture.setThings(drawn);
    rendering.setThings(drawn);
    things.setThings(message.things);
  },
  scene(message) {
    scenes.push(message);
  },
  status(message) {
    window.ikservo.status = message;
    showStatus(message);
  },
  plots(message) { plots.receive(message); },
  download,
  refused(message) { panel.showRefusal(message); },
  heard() { freshness.heard(); },
  closed(why, reason) {
    scenes = [];
    freshness.disconnect();
    stopButton.disconnect();
    showOffline(why, reason);
    if (why === "none" || why === "closed") arms.show();
  },
}, options.has("arm") ? `live/${options.get("arm")}` : "live");
const send = (kind, fields) => connection.send(kind, fields);
const panel = new Panel(send);
const program = new Program(send, (message) => panel.showRefusal({ message, hint: "" }));
const plots = new Plots(send);
const poses = new Poses(send);
const servos = new Servos(send);
const things = new Things(send, (message) => panel.showRefusal({ message, hint: "" }));
const actions = new Actions(send);
const appPanels = new AppPanels(send);
const leader = new Leader(key, send, () => sendViewport());
const arms = new Arms(
  key,
  options,
  (name) => leader.choose(name),
  (names) => things.setOthers(names),
  (camera) => send("choose_camera", { camera }),
);
const rendering = new Rendering($("webgl"), options.get("draw"), () => {
  if (armInfo && !viewIsChosen && viewBefore === null && !rendering.wanted) view = rendering.firstView(armInfo.views);
  frameTime.set(0);
});
const stopButton = new StopButton(send, (refusal) => panel.showRefusal(refusal));
const freshness = new Freshness(() => showOffline("silent"), () => window.ikservo.status && showStatus(window.ikservo.status));
const frameTime = new FrameTime(onDetail);
Object.assign(window.ikservo, { rendering, frameTime });
panel.isDrawingTried = () => rendering.isTrying();
const overlays = [actions, poses, arms]; // each has a list or text that covers others
for (const part of overlays) part.onOpen = () => overlays.forEach((other) => other === part || other.dismiss());
const calibration = new CalibrationScreens(send);
const overLink = () => Boolean(window.ikservo.scene?.hover) && window.ikservo.status?.controller === "you";
const pointerInput = new PointerInput(canvas, send, overLink);
const handleInput = new HandleInput(canvas.parentElement, canvas, () => rendering.drawn(), send);
const heightField = new NumberField({
  label: "Height above the table", unit: "mm", refuse: (message) => panel.showRefusal({ message, hint: "" }),
  submit(value) {
    height = Math.min(Math.max(value * MM, -1), 2);
    heightField.show(height / MM, false);
    sendViewport();
  },
});
$("height-field").append(heightField.element, " mm");
heightField.show(height / MM, false);
$("mark-tip").onclick = () => takeClick(isOn($("mark-tip")) ? null : (at) => { takeClick(null); send("mark_tip", at); }, "mark-tip");
$("grasp").onclick = () => {
  if (isOn($("grasp"))) return takeClick(null);
  takeClick(({ x, y }) => send("grasp", { at: [x, y] }), "grasp");
  send("grasp", {}); // list the blocks
};
const gamepads = new Gamepads(send, (text) => { $("gamepad").textContent = text; });
gamepads.bindButton($("gripper-open"), -1);
gamepads.bindButton($("gripper-close"), 1);
const hand = new Hand(send, gamepads, () => stopButton.press("gamepad"), () => episode.toggle(), drawFrame);
const episode = new Episode(send, (ms) => hand.session && hand.buzz(ms));

const isOn = (button) => button.getAttribute("aria-checked") === "true";

// Pass presses to take(at) for a button; null makes presses gestures again.
function takeClick(take, id) {
  pointerInput.take = take;
  for (const each of ["mark-tip", "grasp"]) setAttribute($(each), "aria-checked", each === id);
}

function showStatus(status) {
  setOnline(true);
  freshness.setReadAge(status.age_s);
  rendering.setLive(status.live && status.controller === "you");
  panel.show(status);
  program.show(status);
  actions.show(status);
  leader.show(status);
  appPanels.setReady(isIdle(status));
  episode.setReady(status.controller === "you");
  $("grasp").disabled = !isIdle(status);
  const hasPicture = view === "camera" || (armInfo.views.includes("camera") && arms.camera.place !== "off");
  $("grasp").hidden = !hasPicture || !armInfo.gripper;
  if ($("grasp").hidden && isOn($("grasp"))) takeClick(null);
  stopButton.show(status);
  calibration.show(status.calibration);
  showAllAround(Boolean(status.calibration));
  plots.showStatus(status);
  servos.showStatus(status);
  things.showStatus(status);
}

// A calibration uses the orbit view, which shows the motion of each joint; then the old view returns.
let viewBefore = null;
function showAllAround(calibrating) {
  if (calibrating === (viewBefore !== null)) return;
  const next = calibrating ? "orbit" : viewBefore;
  viewBefore = calibrating ? view : null;
  if (armInfo.views.includes(next)) view = next;
  sendViewport();
}

// Enlarge the pose in which a calibration begins; show everything again afterwards.
const POSE_ZOOM = 1.9;
let isEnlarged = false;
function enlargePose({ camera }, at) {
  const stage = window.ikservo.status?.calibration?.stage;
  if (isEnlarged && !stage) send("fit_view");
  const fits = Math.abs(camera.size[0] - canvas.clientWidth) < 1; // the screens beside it are shown
  const enlarges = stage === "anchor" && !isEnlarged && fits && view === "orbit" && camera.perspective;
  if (enlarges) send("orbit_camera", { dx: 0, dy: 0, zoom: POSE_ZOOM, at });
  isEnlarged = Boolean(stage) && (isEnlarged || enlarges);
}

const OFFLINE = {
  "wrong-key": { message: "The page's key is not valid in this session.", hint: "Open the address that `ikservo view` printed." },
  none: { message: "This arm is not open.", hint: "Choose one in the list of arms." },
  closed: { message: "This arm was closed; its torque has not changed.", hint: "Choose one in the list of arms." },
  full: { hint: "Close one of them; this page then connects by itself." },
  lost: { message: "No connection to `ikservo view`: Stop cannot reach the arm from here.", hint: "" },
  silent: { message: "`ikservo view` does not answer: Stop may not reach the arm.", hint: "" },
};

// The reason is the text with which the server closed the connection.
function showOffline(why, reason) {
  setOnline(false);
  document.body.dataset.mode = ["wrong-key", "full"].includes(why) ? "lost" : why;
  const { message = reason, hint } = OFFLINE[why];
  panel.showOffline({ message, hint });
}

// Controls that need the server are disabled without it; messages can still be read.
function setOnline(online) {
  for (const element of document.querySelectorAll("[data-online]")) element.toggleAttribute("inert", !online);
}

// Report a slow drawing, and draw with less detail from now on.
function onDetail() {
  const is3D = Boolean(rendering.drawn());
  if (is3D && rendering.giveUpSlow(frameTime.slowMs, frameTime.level)) return; // giveUpSlow sets the detail of 2D
  const text = frameTime.describe(is3D ? "3D" : "The drawing");
  if (text && text !== $("slow").textContent) panel.note(text);
  setText($("slow"), text);
  sendViewport();
}

function sendViewport() {
  if (!armInfo) return;
  drawing.fit(frameTime.pixelRatio);
  const { clientWidth: w, clientHeight: h } = canvas;
  arms.camera.setView(view === "camera");
  $("height-field").hidden = view !== "camera";
  send("viewport", { w, h, dpr: devicePixelRatio, view, webgl: rendering.wantsShapes(view), handles: rendering.wantsHandles(), height_m: height });
  updateChoices($("views"), armInfo.views, view, (name) => { view = name; viewIsChosen = true; frameTime.set(0); }, (name) => VIEWS[name]);
}

function onAnimationFrame(now) {
  requestAnimationFrame(onAnimationFrame);
  if (!hand.session) drawFrame(now); // in a headset, only its session has frames
}

function drawFrame(now) {
  if (rendering.isTrying()) frameTime.restart(); // 3D times its own frames, after compiling shaders
  const scene = frameTime.tick(now) ? scenes.shift() : null;
  if (scene) frameTime.drawn(now);
  if (scene) connection.seen = scene.seq;
  pointerInput.flush();
  handleInput.flush();
  hand.flush();
  panel.joints.flush();
  gamepads.poll(now);
  if (scene) show(scene);
}

function show(scene) {
  connection.confirmDrawn(scene.seq); // confirm before drawing, so that the server prepares the next scene meanwhile
  scene = { ...scene };
  if (!frameTime.detail.swept) scene.swept = null;
  rendering.show(scene, frameTime);
  const { backdrop, items, goalAt } = picture.compose(scene);
  drawing.show(backdrop, items);
  canvas.toggleAttribute("data-hover", Boolean(scene.hover));
  canvas.toggleAttribute("data-grabbed", Boolean(scene.grabbed));
  if (!scene.tip_shows && isOn($("mark-tip"))) takeClick(null);
  $("mark-tip").hidden = !scene.tip_shows;
  setText($("mark-tip"), scene.tip_clicks ? `Click the tip (${scene.tip_clicks} so far)` : "Click the tip");
  canvas.toggleAttribute("data-picked", Boolean(scene.picked || pointerInput.take));
  showRefusal(scene.refusal, goalAt);
  showMission(scene, goalAt);
  arms.camera.showPictureTrouble(scene.picture_trouble);
  enlargePose(scene, goalAt);
  setText($("execute"), scene.path?.several ? "Go" : "Go there");
  actions.follow(scene.path, scene.goal && !scene.grabbed ? goalAt : null);
  Object.assign(window.ikservo, { scene, items });
  window.ikservo.drawn += 1;
}

// Show why the goal is refused beside its target in the drawing, and also where a target is typed,
// because the drawing may be out of sight there.
function showRefusal(reason, at) {
  const box = $("refusal");
  setText($("target-note"), reason ?? "");
  box.hidden = !reason;
  if (!reason) return;
  setText(box, reason);
  const [left, top] = place(at, box, canvas.getBoundingClientRect());
  box.style.transform = `translate(${left}px, ${top}px)`;
}

// A hint for the first action, beside the tip, until the user has acted.
let missionDone = false;
function showMission(scene, at) {
  const status = window.ikservo.status;
  missionDone ||= Boolean(scene.grabbed || scene.goal);
  const box = $("mission");
  box.hidden = missionDone || status?.controller !== "you" || !["preview", "live"].includes(status.mode);
  if (box.hidden) return;
  setText(box, matchMedia("(pointer: coarse)").matches ? "Touch the arm and pull" : "Grab the arm and pull");
  const [left, top] = place(at, box, canvas.getBoundingClientRect());
  box.style.transform = `translate(${left}px, ${top}px)`;
}

// Space and Escape stop, wherever the focus is. Escape also closes overlays; Enter presses a
// button.
addEventListener("keydown", (event) => {
  if (event.key !== " " && event.key !== "Escape") return;
  event.preventDefault();
  event.stopPropagation();
  if (event.repeat) return;
  const by = event.key === " " ? "Space" : event.key;
  stopButton.press(by);
  arms.stopSeveral(by);
  if (by === "Escape") for (const part of [...overlays, plots]) part.dismiss();
}, { capture: true });
// N selects the thing behind the one under the pointer, Shift+N the thing in front of it.
addEventListener("keydown", (event) => {
  const typing = event.target.closest?.("input, select") || event.ctrlKey || event.metaKey || event.altKey;
  if (event.key.toLowerCase() === "n" && !typing) send("behind", { step: event.shiftKey ? -1 : 1 });
});
addEventListener("keyup", (event) => { if (event.key === " ") event.preventDefault(); }, { capture: true });

new ResizeObserver(sendViewport).observe(canvas);
const watchPixelRatio = () => {
  matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener("change", () => { sendViewport(); watchPixelRatio(); }, { once: true });
};
watchPixelRatio();
requestAnimationFrame(onAnimationFrame);
