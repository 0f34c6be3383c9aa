// One row per joint: position, goal as slider and number, steps, and torque of its servo.

import { $, createElement, setAttribute, setText, updateChoices, updateRows } from "./elements.js";
import { Meter } from "./meter.js";
import { NumberField, createStepButton } from "./number_field.js";

const STEPS = ["0.1", "1", "5", "10"]; // degrees or millimetres
const CONFIRM_MS = 4000;

export class Joints {
  constructor(send, refuse) {
    this.send = send;
    this.refuse = refuse;
    this.step = "1";
    this.pending = new Map(); // goals of sliders, at most one message per frame
  }

  setArm({ ranges }) {
    this.ranges = ranges;
    $("joints").replaceChildren();
    $("joints").rows = [];
    this.showSteps();
  }

  showSteps() {
    updateChoices($("joint-steps"), STEPS, this.step, (step) => { this.step = step; this.showSteps(); });
  }

  flush() {
    for (const [joint, value] of this.pending) this.send("set_joint", { joint, value });
    this.pending.clear();
  }

  show({ joints, goals, health, live }, movable) {
    const entries = joints.map((joint, i) => ({ joint, goal: goals[i], range: this.ranges[i], torque: health.joints[i].torque === "on" }));
    updateRows($("joints"), entries, () => this.createRow(this.ranges[$("joints").rows.length]), (row, entry) => showRow(row, entry, movable, live));
  }

  createRow({ name, unit, low, high }) {
    const row = { name: createElement("span", {}, name), value: createElement("span"), meter: new Meter() };
    row.slider = createElement("input", { type: "range", min: low, max: high, step: 0.1, "aria-label": `Goal of ${name}` });
    row.slider.addEventListener("input", () => this.pending.set(name, Number(row.slider.value)));
    row.slider.addEventListener("pointerdown", () => { row.held = true; });
    for (const end of ["pointerup", "pointercancel", "blur"]) row.slider.addEventListener(end, () => { row.held = false; });
    row.field = new NumberField({ label: name, unit, refuse: this.refuse, submit: (value) => this.send("set_joint", { joint: name, value }) });
    row.steps = [-1, 1].map((sign) => createStepButton(sign, name, () => this.send("jog_joint", { joint: name, step: sign * Number(this.step) })));
    row.torque = createElement("button", { type: "button", class: "torque", role: "switch", onclick: () => this.switchTorque(row, name) });
    row.element = createElement("li", { "data-joint": name }, row.name, row.value, row.torque,
      createElement("div", { class: "goal-row" }, createElement("div", { class: "slide" }, row.meter.element, row.slider), row.steps[0], row.field.element, row.steps[1]));
    return row;
  }

  // Without torque the link falls, so this takes a second press.
  switchTorque(row, name) {
    const on = row.torque.getAttribute("aria-checked") === "true";
    if (on && !row.asked) {
      row.asked = true;
      setText(row.torque, "The joint may fall. Sure?");
      setTimeout(() => { row.asked = false; showTorque(row, on); }, CONFIRM_MS);
      return;
    }
    row.asked = false;
    this.send("set_torque", { joint: name, on: !on });
  }
}

function showRow(row, { joint, goal, range, torque }, movable, live) {
  setText(row.value, joint.text);
  setAttribute(row.value, "class", `value ${joint.state}`);
  const unit = range.unit === "°" ? "°" : ` ${range.unit}`;
  const text = `${joint.text}, of ${range.low}${unit} to ${range.high}${unit}`;
  row.meter.show({ value: joint.fraction, text, goal: joint.goal, state: joint.state, label: joint.name });
  row.field.show(goal, !movable);
  row.slider.disabled = !movable;
  if (!row.held) row.slider.value = goal;
  setAttribute(row.slider, "aria-valuetext", `${goal.toFixed(1)}${unit}`);
  for (const button of row.steps) button.disabled = !movable;
  row.torque.disabled = !movable || live;
  setAttribute(row.torque, "aria-checked", torque);
  setAttribute(row.torque, "aria-label", `Torque of ${joint.name}`);
  if (!row.asked) showTorque(row, torque);
}

function showTorque(row, torque) {
  setText(row.torque, torque ? "holds" : "limp");
}
