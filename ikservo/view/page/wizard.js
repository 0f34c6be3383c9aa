// The screens of a calibration: reference pose, range of motion, review. The server has the state.

import { $, createElement, setAttribute } from "./elements.js";
import { Meter } from "./meter.js";

const STAGES = [["anchor", "Pose"], ["sweep", "Sweep"], ["review", "Review"], ["saved", "Saved"]];
const ACCEPT_LABELS = { anchor: "I hold it there", sweep: "Every joint is done", review: "Save", saved: "Back to the arm" };

export class Wizard {
  constructor(send) {
    this.send = send;
    this.shown = "";
    this.stage = null; // of the screen that is shown
  }

  show(calibration) {
    $("wizard").hidden = !calibration;
    const stage = $("wizard").parentElement; // beside the wizard the arm is drawn, at first large
    if (calibration) setAttribute(stage, "data-wizard", calibration.stage);
    else stage.removeAttribute("data-wizard");
    const fingerprint = JSON.stringify(calibration ?? null);
    if (fingerprint === this.shown) return;
    this.shown = fingerprint;
    if (calibration) this.render(calibration);
  }

  render(calibration) {
    const focused = document.activeElement?.dataset?.action;
    const current = STAGES.findIndex(([stage]) => stage === calibration.stage);
    const parts = [
      createElement("ol", { class: "steps" }, ...STAGES.map(([, label], i) => createElement("li", { class: i < current ? "done" : "", "aria-current": i === current ? "step" : null }, label))),
      createElement("p", { class: "task", role: "status" }, calibration.task),
      ...calibration.lines.map((line) => createElement("p", {}, line)),
      createElement("ul", { class: "meters" }, ...calibration.meters.map((meter) => this.createMeter(meter, calibration.stage))),
      calibration.error ? createElement("p", { class: "error", role: "alert" }, calibration.error) : null,
      createElement("div", { class: "actions-main" }, ...this.createActions(calibration)),
    ];
    $("wizard").replaceChildren(...parts.filter(Boolean));
    if (focused) $("wizard").querySelector(`[data-action="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
    if (calibration.stage !== this.stage) $("wizard").scrollTop = 0; // where the next task is
    this.stage = calibration.stage;
  }

  createMeter(meter, stage) {
    const range = new Meter();
    range.show({ value: meter.fraction, text: meter.text, recorded: meter.recorded, label: meter.name });
    const button = (action, label) => createElement("button", { type: "button", "data-action": `${action} ${meter.name}`, onclick: () => this.send("calibration", { action, joint: meter.name }) }, label);
    return createElement("li", {},
      createElement("span", { class: meter.current ? "current" : "" }, meter.name),
      createElement("span", { class: "small" }, meter.state),
      createElement("div", {}, range.element),
      createElement("span", { class: "small" }, meter.text),
      stage === "sweep" ? createElement("div", { class: "actions" }, button("remeasure", "Again"), button("skip", "Skip"), button("continuous", "Turns freely")) : null);
  }

  createActions({ stage, allowed }) {
    const button = (action, label, kind) => createElement("button", { type: "button", class: kind, "data-action": action, disabled: !allowed.includes(action), onclick: () => this.send("calibration", { action }) }, label);
    if (stage === "saved") return [button("cancel", ACCEPT_LABELS.saved, "primary")];
    const protect = stage === "review" ? [button("protect", "Save, and let the servos hold these limits, too", "ghost")] : [];
    return [button("accept", ACCEPT_LABELS[stage], "primary"), ...protect, button("undo", "Back", "ghost"), button("cancel", "Leave", "ghost")];
  }
}
