// The control table of a joint's servo: read on request, filtered by name, written as number or quantity.

import { $, createElement, setAttribute, setText, updateRows } from "./elements.js";

export class Servos {
  constructor(send) {
    this.send = send;
    this.registers = [];
    this.joint = null;
    this.movable = false;
    $("servos")?.addEventListener("toggle", () => $("servos").open && !this.joint && this.read());
    $("servos-joint").onchange = () => this.read();
    $("servos-read").onclick = () => this.read();
    $("servos-filter").oninput = () => this.show();
  }

  setArm({ joints }) {
    this.joint = null;
    this.registers = [];
    $("servos-joint").replaceChildren(...joints.map((name) => createElement("option", { value: name }, name)));
    this.show();
  }

  showStatus({ controller, mode, live }) {
    this.movable = controller === "you" && mode === "preview" && !live;
    for (const control of $("servos")?.querySelectorAll("button, input, select") ?? []) control.disabled = !this.movable;
  }

  read() {
    this.send("read_servo", { joint: $("servos-joint").value });
  }

  receive({ joint, id, model, registers, note }) {
    if (!joint) return;
    [this.joint, this.registers] = [joint, registers];
    $("servos-joint").value = joint;
    setText($("servos-title"), `${model}, id ${id}`);
    setText($("servos-note"), note);
    this.show();
  }

  show() {
    const words = $("servos-filter").value.trim().toLowerCase();
    const shown = this.registers.filter(({ name }) => name.includes(words));
    updateRows($("servos-table"), shown, () => this.createRow(), showRegister);
  }

  createRow() {
    const row = { name: createElement("span"), value: createElement("span", { class: "value" }), register: null };
    row.input = createElement("input", { type: "text", autocomplete: "off", onchange: () => this.write(row) });
    row.was = createElement("span", { class: "quiet" });
    row.element = createElement("li", {}, row.name, row.input, row.value, row.was);
    return row;
  }

  write({ register, input }) {
    const text = input.value.trim();
    if (text && text !== String(register.raw)) this.send("write_register", { joint: this.joint, name: register.name, value: text });
    else input.value = register.raw;
  }
}

function showRegister(row, register) {
  row.register = register;
  const [low, high] = register.range;
  setText(row.name, register.name);
  setText(row.value, register.value);
  const others = { was: register.first, default: register.default === register.raw ? null : register.default };
  setText(row.was, Object.entries(others).filter(([, raw]) => raw !== null).map(([word, raw]) => `${word} ${raw}`).join(", "));
  setAttribute(row.element, "data-register", register.name);
  setAttribute(row.element, "data-area", register.area);
  setAttribute(row.input, "aria-label", register.name);
  setAttribute(row.input, "title", register.writable ? `${low} to ${high}, ${register.area}; a number with a unit is a quantity` : "the page cannot write this register");
  row.input.readOnly = !register.writable;
  if (document.activeElement !== row.input) row.input.value = register.raw;
}
