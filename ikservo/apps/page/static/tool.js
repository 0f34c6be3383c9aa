// The tool at the goal: its coordinates, angles and direction, typed or in steps.

import { $, createElement, updateChoices } from "./elements.js";
import { NumberField, createStepButton, parseNumber } from "./number_field.js";

const VALUES = [["x", "mm", "forward"], ["y", "mm", "to the left, seen from behind the base"], ["z", "mm", "up"], ["pitch", "°", "above the horizontal"], ["roll", "°", "about the tool's own axis"]];
const STEPS = ["1", "5", "20"]; // millimetres or degrees

export class Tool {
  constructor(send, refuse) {
    this.send = send;
    this.refuse = refuse;
    this.step = "5";
    this.fields = VALUES.map(([what, unit, meaning]) => this.createField(what, unit, meaning));
    this.direction = createElement("input", { type: "text", autocomplete: "off", id: "tool-direction", "aria-label": "Direction of the tool, three numbers" });
    this.direction.addEventListener("input", () => { this.dirty = true; });
    this.direction.addEventListener("change", () => this.sendDirection());
    this.direction.addEventListener("blur", () => { this.dirty = false; });
    $("tool-values").replaceChildren(...this.fields.map(({ element }) => element),
      createElement("div", { class: "tool-value wide" }, createElement("span", { "aria-hidden": "true" }, "direction"), this.direction));
    this.showSteps();
  }

  createField(what, unit, meaning) {
    const field = new NumberField({ label: `Tool ${what}`, unit, refuse: this.refuse, submit: (value) => this.send("set_tool", { what, value }) });
    field.element.id = `tool-${what}`;
    const buttons = [-1, 1].map((sign) => createStepButton(sign, `Tool ${what}`, () => this.send("jog_tool", { what, step: sign * Number(this.step) })));
    const label = createElement("span", { "aria-hidden": "true" }, what);
    return { what, field, buttons, element: createElement("div", { class: "tool-value", title: `${what}: ${meaning}` }, label, buttons[0], field.element, buttons[1]) };
  }

  showSteps() {
    updateChoices($("tool-steps"), STEPS, this.step, (step) => { this.step = step; this.showSteps(); });
  }

  sendDirection() {
    this.dirty = false;
    const direction = this.direction.value.trim().split(/[\s;]+/).map(parseNumber);
    if (direction.length === 3 && !direction.includes(null)) this.send("point_tool", { direction });
    else this.refuse(`“${this.direction.value.slice(0, 30)}” is not a direction: give three numbers such as 0 0 -1. The tool stays.`);
  }

  show({ tool }, movable) {
    for (const { what, field, buttons } of this.fields) {
      field.show(tool[what], !movable);
      for (const button of buttons) button.disabled = !movable;
    }
    this.direction.disabled = !movable;
    const text = tool.direction.map((part) => part.toFixed(2)).join(" ");
    if (!this.dirty && this.direction.value !== text) this.direction.value = text;
  }
}
