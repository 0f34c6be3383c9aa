// A range with a needle. It is made once and then moved: what is not laid out anew costs little.

import { make, setAttribute } from "./elements.js";

const share = (value) => Math.min(1, Math.max(0, value));

export class Meter {
  constructor() {
    this.swept = make("div", { class: "swept", hidden: true });
    this.goal = make("div", { class: "goal", hidden: true });
    this.needle = make("div", { class: "needle" });
    this.element = make("div", { class: "range", role: "meter", "aria-valuemin": 0, "aria-valuemax": 1 },
      make("div", { class: "track" }), this.swept, this.goal, this.needle);
  }

  // All positions are shares of the width.
  show({ value, words, goal = null, state = "", swept = null, label }) {
    setAttribute(this.element, "aria-label", label);
    setAttribute(this.element, "aria-valuenow", share(value).toFixed(3));
    setAttribute(this.element, "aria-valuetext", words || "not moved yet");
    setAttribute(this.needle, "class", `needle ${state}`);
    moved(this.needle, value);
    this.goal.hidden = goal === null;
    if (goal !== null) moved(this.goal, goal);
    this.swept.hidden = !swept;
    if (swept) this.swept.style.inset = `auto ${100 * (1 - share(swept[1]))}% auto ${100 * share(swept[0])}%`;
  }
}

// Each needle is as wide as its range, so that a share of its own width is one of the range's.
function moved(element, value) {
  const transform = `translateX(${(100 * share(value)).toFixed(2)}%)`;
  if (element.style.transform !== transform) element.style.transform = transform;
}
