// The screens of a calibration from the server: task, answers, a meter for each joint.

import { $, createElement, setAttribute } from "./elements.js";
import { Meter } from "./meter.js";

const STAGES = [["anchor", "Pose"], ["sweep", "Sweep"], ["review", "Review"], ["saved", "Saved"]];

export class CalibrationScreens {
  constructor(send) {
    this.send = send;
    this.shown = "";
    this.stage = null; // the stage of the shown screen
  }

  show(calibration) {
    $("calibration").hidden = !calibration;
    const stage = $("calibration").parentElement; // the arm is drawn beside the screens, large at the start
    if (calibration) setAttribute(stage, "data-calibration", calibration.stage);
    else stage.removeAttribute("data-calibration");
    const fingerprint = JSON.stringify(calibration ?? null);
    if (fingerprint === this.shown) return;
    this.shown = fingerprint;
    if (calibration) this.render(calibration);
    else this.stage = null;
  }

  render(calibration) {
    const focused = document.activeElement?.dataset?.action;
    const current = STAGES.findIndex(([stage]) => stage === calibration.stage);
    const parts = [
      createElement("ol", { class: "steps" }, ...STAGES.map(([, label], i) => createElement("li", { class: i < current ? "done" : "", "aria-current": i === current ? "step" : null }, label))),
      createElement("p", { class: "task", role: "status" }, calibration.task),
      calibration.share !== null ? createElement("progress", { value: calibration.share, "aria-label": "Done" }) : null,
      calibration.shows_pose ? createElement("p", { class: "quiet" }, "Bring your real arm into the pose of the pale one. The dark one shows what the servos report; it need not match yet.") : null,
      ...calibration.lines.map((line) => createElement("p", {}, line)),
      createElement("ul", { class: "meters" }, ...calibration.meters.map((meter) => this.createMeter(meter, calibration))),
      calibration.error ? createElement("p", { class: "error", role: "alert" }, calibration.error) : null,
      createElement("div", { class: "actions-main" }, ...this.createButtons(calibration, ({ joints }) => !joints.length)),
    ];
    $("calibration").replaceChildren(...parts.filter(Boolean));
    if (focused) $("calibration").querySelector(`[data-action="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
    if (calibration.stage !== this.stage) $("calibration").scrollTop = 0; // the next task is at the top
    if (!this.stage) $("calibration").scrollIntoView({ block: "nearest" });
    this.stage = calibration.stage;
  }

  createMeter(meter, calibration) {
    const range = new Meter();
    range.show({ value: meter.fraction, text: meter.text, recorded: meter.recorded, label: meter.name });
    return createElement("li", {},
      createElement("span", { class: meter.current ? "current" : "" }, meter.name),
      createElement("span", { class: "small" }, meter.state),
      createElement("div", {}, range.element),
      createElement("span", { class: "small" }, meter.text),
      createElement("div", { class: "actions" }, ...this.createButtons(calibration, ({ joints }) => joints.includes(meter.name), meter.name)));
  }

  createButtons({ choices, number }, isShown, joint) {
    return choices.filter(isShown).map(({ answer, label }, i) => createElement("button", { type: "button", class: joint ? null : i ? "ghost" : "primary", "data-action": joint ? `${answer} ${joint}` : answer, onclick: () => this.send("calibration", { action: answer, joint, number }) }, label));
  }
}
