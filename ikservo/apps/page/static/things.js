// The things around the arm: a row with name, place and size of each; saved as a scene file.

import { $, createElement, setText } from "./elements.js";
import { NumberField } from "./number_field.js";

const MM = 0.001;
const AXES = ["x", "y", "z"];
const TITLES = { box: "box", cylinder: "can", sphere: "ball", half_space: "half space", arm: "arm" };
// Labels and units of the numbers, by the keys of a scene file.
const SIZES = {
  box: [["size_m", AXES.map((axis) => `length ${axis}`), "mm"], ["rpy_deg", ["roll", "pitch", "yaw"], "°"]],
  cylinder: [["radius_m", "radius", "mm"], ["height_m", "height", "mm"]],
  sphere: [["radius_m", "radius", "mm"]],
  half_space: [],
  arm: [["rpy_deg", ["roll", "pitch", "yaw"], "°"]],
};

export class Things {
  // Calls refuse(sentence) if the user types something wrong.
  constructor(send, refuse) {
    Object.assign(this, { send, refuse, rows: [], others: [], movable: false });
    for (const shape of ["box", "cylinder", "sphere"]) $(`add-${shape}`).onclick = () => send("add_thing", { shape });
    $("things-save").onclick = () => send("save_things");
  }

  // A row is replaced only if it shows another thing, so that an element keeps the focus.
  setThings(things) {
    setText($("things-count"), things.length ? String(things.length) : "");
    const same = (row, { name, thing }) => row?.name === name && row.kind === thing;
    const before = this.rows;
    this.rows = things.map((thing, i) => (same(before[i], thing) ? before[i] : this.createRow(thing)));
    if (this.rows.length !== before.length || this.rows.some((row, i) => row !== before[i])) {
      $("things").replaceChildren(...this.rows.map(({ element }) => element));
    }
    things.forEach((thing, i) => this.showSizes(this.rows[i], thing.sizes));
    this.showOthers();
  }

  // The other arms of the page, which can be added as obstacles.
  setOthers(names) {
    this.others = names;
    this.showOthers();
  }

  showOthers() {
    const names = this.others.filter((name) => !this.rows.some((row) => row.name === name));
    if (names.join() === $("add-arms").dataset.names) return;
    $("add-arms").dataset.names = names.join();
    $("add-arms").replaceChildren(...names.map((name) => createElement("button", {
      type: "button", class: "ghost small", disabled: !this.movable, onclick: () => this.send("add_other_arm", { name }),
    }, `+ ${name}`)));
  }

  showStatus({ controller, mode, live }) {
    this.movable = controller === "you" && mode === "preview" && !live;
    for (const control of $("things-card").querySelectorAll("button:not(#things-save), input")) control.disabled = !this.movable;
  }

  createRow({ name, thing: kind }) {
    const change = (fields) => this.send("change_thing", { name, ...fields });
    const title = createElement("input", { type: "text", autocomplete: "off", maxlength: 40, "aria-label": `Name of ${name}`, value: name });
    title.readOnly = kind === "arm";
    title.onchange = () => (title.value.trim() ? change({ new_name: title.value.trim() }) : (title.value = name));
    const remove = createElement("button", { type: "button", class: "ghost small", "aria-label": `Remove ${name}`, onclick: () => this.send("remove_thing", { name }) }, "×");
    const row = { name, kind, fields: [], element: createElement("li", { "data-thing": name }, title, createElement("span", { class: "quiet" }, TITLES[kind]), remove) };
    const keys = kind === "half_space" ? [] : [[kind === "arm" ? "at_m" : "center_m", AXES, "mm"], ...SIZES[kind]];
    for (const [key, labels, unit] of keys) row.element.append(this.createNumbers(row, { key, labels, unit }, change));
    return row;
  }

  createNumbers(row, { key, labels, unit }, change) {
    const group = createElement("div", { class: "thing-numbers" });
    [labels].flat().forEach((label, i) => {
      const factor = unit === "mm" ? MM : 1;
      const entry = { key, index: Array.isArray(labels) ? i : null, factor };
      entry.field = new NumberField({
        label: `${row.name}: ${label}`, unit, refuse: this.refuse,
        submit: (value) => change({ [key]: entry.index === null ? value * factor : only(entry.index, value * factor) }),
      });
      row.fields.push(entry);
      group.append(createElement("label", {}, `${label} `, entry.field.element));
    });
    group.append(createElement("span", { class: "quiet" }, unit));
    return group;
  }

  showSizes(row, sizes) {
    for (const entry of row.fields) {
      const value = entry.index === null ? sizes[entry.key] : sizes[entry.key][entry.index];
      entry.field.show(value / entry.factor, !this.movable);
    }
  }
}

// Three numbers, one of which was typed; null leaves the others unchanged.
function only(index, value) {
  return AXES.map((_, i) => (i === index ? value : null));
}
