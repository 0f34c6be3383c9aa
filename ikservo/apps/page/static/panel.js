// The texts and meters beside the drawing, all from the status of the server.

import { $, createElement, setAttribute, setText, updateChoices, updateRows } from "./elements.js";
import { Joints } from "./joints.js";
import { Preference } from "./preference.js";
import { Tool } from "./tool.js";

const MODES = {
  preview: "Preview",
  live: "Live – the arm follows",
  stopped: "Stopped",
  busy: "",
  lost: "Not connected",
  none: "No arm",
  closed: "Closed",
  silent: "No answer",
  waiting: "Connecting …",
  calibration: "Calibration",
};
// The source of the zeros of the joints, which gives meaning to their positions.
const ZEROS = {
  calibrated: "calibrated range", vendor: "the manufacturer's zeros", simulated: "limits from the arm file",
  accepted: "zeros from the arm file", unknown: "not calibrated",
};
const SOLVERS = {
  auto: "automatic", pseudo_inverse: "pseudo-inverse", transpose: "transpose", ccd: "CCD",
  bounded: "bounded", closed_form: "closed form",
};
const REFUSAL_MS = 5000;
const MAX_NOTES = 12;
const formatTitle = (name) => name[0].toUpperCase() + name.slice(1).replaceAll("_", " ");

export class Panel {
  constructor(send) {
    this.send = send;
    this.status = null;
    this.wasWell = true; // whether no servo reported a problem before
    this.preference = new Preference(send);
    const refuse = (message) => this.showRefusal({ message, hint: "" });
    this.joints = new Joints(send, refuse);
    this.tool = new Tool(send, refuse);
    this.isDrawingTried = () => false;
    this.offline = null; // the notice while the server does not answer
    this.notes = []; // messages of the page itself
    this.refusal = null; // the last refused command; shown for REFUSAL_MS
    $("acknowledge").onclick = () => send("acknowledge");
    $("go-live").onclick = () => send("set_live", { on: true });
    $("dismiss").onclick = () => send("set_live", { on: false });
    $("take").onclick = () => send("take_control", { on: true });
    $("live").onclick = () => send("set_live", { on: $("live").getAttribute("aria-checked") !== "true" });
    $("calibrate").onclick = () => send("calibration", { action: "start" });
    // Overlays of the drawing are stacked: banner, mode, tools.
    const parts = { above: $("banner"), mode: document.querySelector(".mode"), tools: document.querySelector(".stage-tools") };
    const measure = () => {
      const { style } = document.body;
      for (const [name, part] of Object.entries(parts)) style.setProperty(`--${name}`, `${part.offsetHeight}px`);
      style.setProperty("--tools-width", `${parts.tools.offsetWidth}px`);
    };
    const observer = new ResizeObserver(measure);
    for (const part of Object.values(parts)) observer.observe(part);
  }

  setArm(armInfo) {
    this.armInfo = armInfo;
    this.clockStart = Date.now() - 1000 * armInfo.now_s; // start of the server's clock, which dates messages
    setText($("unit"), ZEROS[armInfo.zeros]);
    $("unit").classList.toggle("uncalibrated", armInfo.zeros === "unknown");
    document.title = `${armInfo.title} – ikservo`;
    setText($("title"), armInfo.title);
    setText($("port"), armInfo.port);
    $("gripper").hidden = !armInfo.gripper;
    this.preference.setArm(armInfo);
    this.joints.setArm(armInfo);
    $("calibrate").hidden = armInfo.permission !== "control";
    $("hint").textContent = matchMedia("(pointer: coarse)").matches
      ? "Touch the arm and pull, or tap where the tip should go. Two fingers move the view."
      : "Grab any link and pull · click where the tip should go · Shift turns one joint · N selects the link behind · right button moves the view";
  }

  show(status) {
    this.status = status;
    this.offline = null;
    setAttribute(document.body, "data-mode", status.mode);
    const inControl = status.controller === "you";
    document.body.toggleAttribute("data-refused", status.refused);
    setText($("mode"), this.describeMode(status) + (inControl || status.mode === "stopped" ? "" : status.controller === "other" ? " · another page is in control" : " · you watch"));
    setText($("left"), status.left);
    this.showControls(status, inControl);
    this.showBanner();
    const movable = inControl && (status.mode === "preview" || status.mode === "live");
    this.joints.show(status, movable);
    this.tool.show(status, movable);
    this.showSolver(status.solver);
    this.preference.show(status.preference, inControl);
    this.showHealth(status.health);
    this.showPairs($("tip"), status.tip);
    this.showPairs($("posture"), status.posture);
    this.showCandidates(status.under);
    this.showMessages(status.messages);
  }

  // Say that a limp arm does not hold, and that an uncalibrated arm cannot follow.
  describeMode({ mode, health, activity, calibration }) {
    if (mode === "busy") return `${activity} …`;
    if (mode !== "preview" && mode !== "calibration") return MODES[mode];
    const limp = health.joints.filter((joint) => joint.torque !== "on").map((joint) => joint.name);
    const arm = calibration?.moves ? "the arm moves" : !limp.length ? "the arm holds" : limp.length === health.joints.length ? "the arm is limp" : `limp: ${limp.join(", ")}`;
    return `${MODES[mode]} – ${arm}${this.armInfo.zeros === "unknown" ? "; not calibrated, which Live needs" : ""}`;
  }

  showControls(status, inControl) {
    updateChoices($("speeds"), this.armInfo.speeds, status.speed, (name) => this.send("set_speed", { name }), formatTitle);
    updateChoices($("solvers"), this.armInfo.solvers, status.solver.name, (name) => this.send("set_solver", { name }), (name) => SOLVERS[name] ?? name);
    const live = $("live");
    setAttribute(live, "aria-checked", status.live);
    const trying = this.isDrawingTried(); // trying 3D would delay heartbeats
    setAttribute(live, "title", trying ? "3D is tried first" : "");
    live.disabled = !inControl || trying || this.armInfo.zeros === "unknown" || (status.mode !== "preview" && status.mode !== "live");
    const mayControl = this.armInfo.permission === "control";
    $("take").hidden = inControl || !mayControl;
    for (const button of document.querySelectorAll(":is(#poses, #gripper, #pose-list) button:not(#all-poses)")) button.disabled = !inControl || ["stopped", "busy"].includes(status.mode);
    $("calibrate").disabled = !inControl || status.live || status.mode === "busy";
  }

  // Shows the most urgent notice: no server, a stopped arm, a refused command.
  showBanner() {
    const banner = this.offline ?? this.status?.banner ?? this.refusal;
    $("banner").hidden = !banner;
    if (!banner) return;
    setText($("banner-message"), banner.message);
    setText($("banner-hint"), banner.hint);
    $("acknowledge").disabled = this.armInfo?.permission !== "control";
    $("acknowledge").hidden = banner.action !== "acknowledge"; // only a stop is acknowledged
    const fellBack = banner.action === "go_live";
    $("banner").classList.toggle("news", fellBack);
    for (const id of ["go-live", "dismiss"]) {
      $(id).hidden = !fellBack;
      $(id).disabled = this.status?.controller !== "you";
    }
  }

  // Without the server, the last known torque tells what the arm does now.
  showOffline({ message, hint }) {
    setText($("mode"), MODES[document.body.dataset.mode]);
    setText($("left"), "");
    this.offline = { message, hint: hint || describeAlone(this.status) };
    this.showBanner();
  }

  // Adds a message of the page itself to the list; a repetition renews it.
  note(message, hint = "", level = "") {
    const others = this.notes.filter((note) => note.message !== message);
    this.notes = [...others, { message, hint, level, at: Date.now() }].slice(-MAX_NOTES);
    this.showMessages(this.status?.messages ?? []);
  }

  showRefusal(refusal) {
    this.refusal = refusal;
    this.note(refusal.message, refusal.hint, "bad");
    this.showBanner();
    setTimeout(() => {
      if (this.refusal !== refusal) return;
      this.refusal = null;
      this.showBanner();
    }, REFUSAL_MS);
  }

  showSolver(solver) {
    setText($("solver-time"), solver.time);
    setText($("solver-text"), solver.text);
  }

  showHealth(health) {
    const hottest = Math.max(...health.joints.map(({ temperature }) => parseFloat(temperature)));
    setText($("supply"), `${health.supply}, up to ${hottest} °C`);
    const isWell = health.joints.every(({ level, alarms }) => level === "good" && !alarms);
    if (!isWell && this.wasWell) $("health-card").open = true; // stays open until the user folds it
    this.wasWell = isWell;
    updateRows($("health"), health.joints, createHealthRow, ({ element, cells, alarms }, joint) => {
      const torque = joint.torque === "on" ? "holds" : "limp";
      setAttribute(element, "title", `${joint.name}: ${torque}${joint.alarms ? `, ${joint.alarms}` : ""}`);
      [joint.name, joint.temperature, joint.load, joint.voltage].forEach((text, i) => setText(cells[i], text));
      cells.forEach((cell, i) => setAttribute(cell, "class", i ? joint.level : torque));
      setText(alarms, joint.alarms);
      alarms.hidden = !joint.alarms;
    });
  }

  showPairs(list, pairs) {
    updateRows(list, pairs, createPairRow, (row, [name, text, level]) => {
      setText(row.name, name);
      setText(row.text, text);
      setAttribute(row.text, "class", level);
    });
  }

  // Lists overlapping things under the pointer; a single one needs no list.
  showCandidates(candidates) {
    const shown = candidates.length > 1 ? candidates : [];
    $("under").hidden = !shown.length;
    updateRows($("under"), shown, createCandidateRow, ({ element, cells }, row) => {
      setAttribute(element, "class", row.chosen ? "chosen" : "");
      const name = row.what ? `${row.name} (${row.what})` : row.name;
      [name, row.depth, row.at].forEach((text, i) => setText(cells[i], text));
    });
  }

  // Lists messages of the arm, its guard and refused commands of this page, ordered by time.
  showMessages(messages) {
    const dated = messages.map((entry) => ({ ...entry, at: this.clockStart + 1000 * entry.time_s }));
    const entries = [...dated, ...this.notes].sort((a, b) => a.at - b.at);
    const fingerprint = JSON.stringify(entries);
    if (fingerprint === this.shownMessages) return;
    this.shownMessages = fingerprint;
    $("log").replaceChildren(...entries.map(createMessage));
    $("log").scrollTop = ($("log").lastElementChild?.offsetTop ?? 0) - $("log").offsetTop; // show a long message from its first line on
  }
}

function createMessage({ message, hint, level, at }) {
  const time = createElement("time", { datetime: new Date(at).toISOString() }, new Date(at).toLocaleTimeString());
  return createElement("li", { class: level },
    createElement("div", {}, time, ` ${message}`),
    hint ? createElement("div", { class: "hint-line" }, hint) : null);
}

function describeAlone(status) {
  const torque = status?.health.joints.map((joint) => joint.torque) ?? [];
  const arm = !torque.length ? ""
    : torque.every((each) => each === "on") ? "When last seen, the torque of the arm was on: the arm goes to its last goal and holds. "
      : torque.every((each) => each === "off") ? "When last seen, the arm was limp. " : "When last seen, some of the joints were limp. ";
  return `${arm}To stop it: ikservo stop in a terminal, or switch off its power. Connecting again …`;
}

function createHealthRow() {
  const cells = [0, 1, 2, 3].map(() => createElement("span"));
  const alarms = createElement("span", { class: "alarms" });
  return { element: createElement("li", {}, ...cells, alarms), cells, alarms };
}

function createCandidateRow() {
  const cells = [0, 1, 2].map(() => createElement("span"));
  return { element: createElement("li", {}, ...cells), cells };
}

function createPairRow() {
  const [name, text] = [createElement("dt"), createElement("dd")];
  return { element: createElement("div", {}, name, text), name, text };
}
