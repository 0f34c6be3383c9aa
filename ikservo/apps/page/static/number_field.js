// A text field for a number with a unit. Other text is refused here, and nothing is sent.

import { createElement, setAttribute } from "./elements.js";

const MAX = 1e5; // the server refuses larger numbers

export class NumberField {
  // Calls submit(value) with a number, or refuse(sentence) with the problem.
  constructor({ label, unit, submit, refuse }) {
    Object.assign(this, { label, unit, submit, refuse, dirty: false });
    this.element = createElement("input", { type: "text", inputmode: "decimal", autocomplete: "off", "aria-label": `${label}, ${unit === "°" ? "degrees" : unit}` });
    this.element.addEventListener("input", () => { this.dirty = true; });
    this.element.addEventListener("change", () => this.onChange());
    this.element.addEventListener("focus", () => setTimeout(() => this.select())); // after the press has placed the caret
    this.element.addEventListener("blur", () => { this.dirty = false; });
  }

  // Do nothing if the focus has moved on, because selecting would take it back.
  select() {
    if (document.activeElement === this.element) this.element.select();
  }

  onChange() {
    const value = parseNumber(this.element.value);
    this.dirty = false;
    setAttribute(this.element, "aria-invalid", value === null);
    if (value === null) this.refuse(`“${this.element.value.slice(0, 20)}” is not a number of ${this.unit === "°" ? "degrees" : "millimetres"}: ${this.label} stays.`);
    else this.submit(value);
  }

  // Do not overwrite the field while the user types.
  show(value, disabled) {
    this.element.disabled = disabled;
    const text = value.toFixed(1);
    if (this.dirty || this.element.value === text) return;
    this.element.value = text;
    setAttribute(this.element, "aria-invalid", false);
  }
}

// Return a number, or null for other text; a unit, a comma and a long minus are allowed.
export function parseNumber(text) {
  const plain = text.trim().replace(/\s*(°|deg|mm)$/, "").replace("−", "-").replace(",", ".");
  if (!/^[-+]?(\d+\.?\d*|\.\d+)$/.test(plain)) return null;
  const value = Number(plain);
  return Math.abs(value) <= MAX ? value : null;
}

export function createStepButton(sign, label, onclick) {
  return createElement("button", { type: "button", class: "step", "aria-label": `${label} ${sign < 0 ? "less" : "more"} by one step`, onclick }, sign < 0 ? "−" : "+");
}
