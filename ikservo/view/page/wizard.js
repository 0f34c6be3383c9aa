// The screens of a calibration: the pose, the sweep, the review. The conversation is the server's.

import { $, make } from "./elements.js";
import { Meter } from "./meter.js";

const STAGES = [["anchor", "Pose"], ["sweep", "Sweep"], ["review", "Review"], ["saved", "Saved"]];
const GO_ON = { anchor: "I hold it there", sweep: "Every joint is done", review: "Save", saved: "Back to the arm" };

export class Wizard {
  constructor(say) {
    this.say = say;
    this.print = "";
  }

  show(talk) {
    $("wizard").hidden = !talk;
    const print = JSON.stringify(talk ?? null);
    if (print === this.print) return;
    this.print = print;
    if (talk) this.fill(talk);
  }

  fill(talk) {
    const focused = document.activeElement?.dataset?.act;
    const at = STAGES.findIndex(([stage]) => stage === talk.stage);
    const parts = [
      make("ol", { class: "steps" }, ...STAGES.map(([, words], i) => make("li", { class: i < at ? "done" : "", "aria-current": i === at ? "step" : null }, words))),
      make("p", { class: "task", role: "status" }, talk.task),
      talk.sketch ? make("pre", { class: "sketch", "aria-hidden": "true" }, talk.sketch) : null,
      ...talk.lines.map((line) => make("p", {}, line)),
      make("ul", { class: "meters" }, ...talk.meters.map((meter) => this.meter(meter, talk.stage))),
      talk.complaint ? make("p", { class: "complaint", role: "alert" }, talk.complaint) : null,
      make("div", { class: "acts-main" }, ...this.acts(talk)),
    ];
    $("wizard").replaceChildren(...parts.filter(Boolean));
    if (focused) $("wizard").querySelector(`[data-act="${CSS.escape(focused)}"]`)?.focus();
  }

  meter(meter, stage) {
    const range = new Meter();
    range.show({ value: meter.share, words: meter.text, swept: meter.swept, label: meter.name });
    const act = (word, words) => make("button", { type: "button", "data-act": `${word} ${meter.name}`, onclick: () => this.say("calibrate", { word, joint: meter.name }) }, words);
    return make("li", {},
      make("span", { class: meter.asked ? "asked" : "" }, meter.name),
      make("span", { class: "small" }, meter.state),
      make("div", {}, range.element),
      make("span", { class: "small" }, meter.text),
      stage === "sweep" ? make("div", { class: "acts" }, act("again", "Again"), act("skip", "Skip"), act("free", "Turns freely")) : null);
  }

  acts({ stage, may }) {
    const act = (word, words, kind) => make("button", { type: "button", class: kind, "data-act": word, disabled: !may.includes(word), onclick: () => this.say("calibrate", { word }) }, words);
    if (stage === "saved") return [act("leave", GO_ON.saved, "primary")];
    const protect = stage === "review" ? [act("protect", "Save, and let the servos hold these limits, too", "ghost")] : [];
    return [act("accept", GO_ON[stage], "primary"), ...protect, act("undo", "Back", "ghost"), act("leave", "Leave", "ghost")];
  }
}
