// A range with a needle. Its elements are created once and then moved, which avoids a new layout.

import { createElement, setAttribute } from "./elements.js";

const clamp = (value) => Math.min(1, Math.max(0, value));

export class Meter {
  constructor() {
    this.recorded = createElement("div", { class: "recorded", hidden: true });
    this.goal = createElement("div", { class: "goal", hidden: true });
    this.needle = createElement("div", { class: "needle" });
    this.element = createElement("div", { class: "range", role: "meter", "aria-valuemin": 0, "aria-valuemax": 1 },
      createElement("div", { class: "track" }), this.recorded, this.goal, this.needle);
  }

  // All positions are fractions of the width.
  show({ value, text, goal = null, state = "", recorded = null, label }) {
    setAttribute(this.element, "aria-label", label);
    setAttribute(this.element, "aria-valuenow", clamp(value).toFixed(3));
    setAttribute(this.element, "aria-valuetext", text || "not moved yet");
    setAttribute(this.needle, "class", `needle ${state}`);
    moveTo(this.needle, value);
    this.goal.hidden = goal === null;
    if (goal !== null) moveTo(this.goal, goal);
    this.recorded.hidden = !recorded;
    if (recorded) this.recorded.style.inset = `auto ${100 * (1 - clamp(recorded[1]))}% auto ${100 * clamp(recorded[0])}%`;
  }
}

// Each needle is as wide as its range, so percentages of its width equal those of the range.
function moveTo(element, value) {
  const transform = `translateX(${(100 * clamp(value)).toFixed(2)}%)`;
  if (element.style.transform !== transform) element.style.transform = transform;
}
