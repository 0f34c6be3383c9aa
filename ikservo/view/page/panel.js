// The words and meters beside the drawing; everything shown comes from the server's status.

import { $, choices, make, rows, setAttribute, setText } from "./elements.js";
import { Meter } from "./meter.js";
import { Preference } from "./preference.js";

const MODES = {
  preview: "Preview – the arm does not move",
  live: "Live – the arm follows",
  stopped: "Stopped",
  lost: "Not connected",
  waiting: "Connecting …",
  calibration: "Calibration – the arm is limp",
};
const RANGES = { own: "calibrated range", file: "range of the arm file" };
const SOLVERS = {
  auto: "automatic", pseudo_inverse: "pseudo-inverse", transpose: "transpose", ccd: "CCD",
  bounded: "bounded", closed_form: "closed form",
};
const REFUSAL_MS = 5000;
const title = (word) => word[0].toUpperCase() + word.slice(1).replaceAll("_", " ");

export class Panel {
  constructor(say) {
    this.say = say;
    this.status = null;
    this.preference = new Preference(say);
    this.refusal = null; // what could not be done just now; forgotten by itself
    $("stop").onclick = () => say("stop");
    $("acknowledge").onclick = () => say("acknowledge");
    $("take").onclick = () => say("take", { on: true });
    $("live").onclick = () => say("live", { on: $("live").getAttribute("aria-checked") !== "true" });
    $("calibrate").onclick = () => say("calibrate", { word: "begin" });
  }

  arm(arm) {
    this.about = arm;
    document.title = `${arm.title} – ikservo`;
    setText($("title"), arm.title);
    setText($("port"), arm.port);
    $("poses").replaceChildren(...arm.poses.map((name) => make("button", { type: "button", onclick: () => this.say("pose", { name }) }, title(name))));
    $("jaws").hidden = !arm.gripper;
    this.preference.arm(arm);
    $("calibrate").hidden = arm.right !== "control";
    $("hint").textContent = matchMedia("(pointer: coarse)").matches
      ? "Touch the arm and pull, or tap where the tip should go. Two fingers move the view."
      : "Grab any link and pull · click where the tip should go · Shift turns one joint · N: what is behind · right button moves the view";
  }

  show(status) {
    this.status = status;
    setAttribute(document.body, "data-mode", status.mode);
    const mine = status.controller === "you";
    setText($("mode"), MODES[status.mode] + (mine || status.mode === "stopped" ? "" : status.controller === "other" ? " · somebody else controls" : " · you watch"));
    this.controls(status, mine);
    this.banner(status.banner ?? this.refusal);
    this.meters(status.joints);
    this.solver(status.solver);
    this.preference.show(status.preference, mine);
    this.health(status.health);
    this.pairs($("tip"), status.tip);
    for (const list of document.querySelectorAll(".posture")) this.pairs(list, status.posture);
    this.under(status.under);
    this.messages(status.messages);
  }

  controls(status, mine) {
    choices($("speeds"), this.about.speeds, status.speed, (name) => this.say("speed", { name }), title);
    choices($("solvers"), this.about.solvers, status.solver.name, (name) => this.say("solver", { name }), (name) => SOLVERS[name] ?? name);
    const live = $("live");
    setAttribute(live, "aria-checked", status.live);
    live.disabled = !mine || (status.mode !== "preview" && status.mode !== "live");
    $("take").hidden = mine || this.about.right !== "control";
    $("stop").disabled = this.about.right !== "control";
    for (const button of document.querySelectorAll(".poses button")) button.disabled = !mine || status.mode === "stopped";
    $("calibrate").disabled = !mine || status.live;
  }

  banner(banner) {
    $("banner").hidden = !banner;
    if (!banner) return;
    setText($("banner-message"), banner.message);
    setText($("banner-hint"), banner.hint);
    $("acknowledge").disabled = this.about?.right !== "control";
    $("acknowledge").hidden = this.status?.mode !== "stopped"; // else nothing waits to be looked at
  }

  refuse(refusal) {
    this.refusal = refusal;
    this.banner(this.status?.banner ?? refusal);
    setTimeout(() => {
      if (this.refusal !== refusal) return;
      this.refusal = null;
      this.banner(this.status?.banner);
    }, REFUSAL_MS);
  }

  meters(joints) {
    setText($("unit"), RANGES[joints.every((joint) => joint.from.startsWith("arm file")) ? "file" : "own"]);
    rows($("joints"), joints, jointRow, (row, joint) => {
      setAttribute(row.element, "data-joint", joint.name);
      setText(row.name, joint.name);
      setText(row.value, joint.text);
      setAttribute(row.value, "class", `value ${joint.state}`);
      const words = `${joint.text}, of ${joint.low} to ${joint.high}`;
      row.meter.show({ value: joint.share, words, goal: joint.goal, state: joint.state, label: joint.name });
    });
  }

  solver(solver) {
    setText($("solver-time"), solver.time);
    setText($("solver-words"), solver.words);
  }

  health(health) {
    setText($("supply"), health.supply);
    rows($("health"), health.joints, healthRow, ({ element, cells, alarms }, joint) => {
      const torque = joint.torque === "on" ? "holds" : "limp";
      setAttribute(element, "title", `${joint.name}: ${torque}${joint.alarms ? `, ${joint.alarms}` : ""}`);
      [joint.name, joint.temperature, joint.load, joint.voltage].forEach((words, i) => setText(cells[i], words));
      cells.forEach((cell, i) => setAttribute(cell, "class", i ? joint.level : torque));
      setText(alarms, joint.alarms);
      alarms.hidden = !joint.alarms;
    });
  }

  pairs(list, pairs) {
    rows(list, pairs, pairRow, (row, [name, words, level]) => {
      setText(row.name, name);
      setText(row.words, words);
      setAttribute(row.words, "class", level);
    });
  }

  // What lies behind each other under the pointer; one thing alone needs no list.
  under(under) {
    const shown = under.length > 1 ? under : [];
    $("under").hidden = !shown.length;
    rows($("under"), shown, underRow, ({ element, cells }, row) => {
      setAttribute(element, "class", row.chosen ? "chosen" : "");
      const name = row.what ? `${row.name} (${row.what})` : row.name;
      [name, row.depth, row.at].forEach((words, i) => setText(cells[i], words));
    });
  }

  messages(messages) {
    const print = JSON.stringify(messages);
    if (print === this.said) return;
    this.said = print;
    $("log").replaceChildren(...messages.map(({ message, hint, level }) => make("li", { class: level }, make("div", {}, message), hint ? make("div", { class: "now" }, hint) : null)));
    $("log").scrollTop = $("log").scrollHeight;
  }
}

function jointRow() {
  const [name, value, meter] = [make("span"), make("span"), new Meter()];
  return { element: make("li", {}, name, value, meter.element), name, value, meter };
}

function healthRow() {
  const cells = [0, 1, 2, 3].map(() => make("span"));
  const alarms = make("span", { class: "alarms" });
  return { element: make("li", {}, ...cells, alarms), cells, alarms };
}

function underRow() {
  const cells = [0, 1, 2].map(() => make("span"));
  return { element: make("li", {}, ...cells), cells };
}

function pairRow() {
  const [name, words] = [make("dt"), make("dd")];
  return { element: make("div", {}, name, words), name, words };
}
