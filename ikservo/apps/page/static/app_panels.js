// Panels of other apps: rows of text, and buttons for their motions.

import { $, createElement, setText } from "./elements.js";

export class AppPanels {
  constructor(send) {
    this.send = send;
    this.isReady = false;
  }

  show({ panels }) {
    const shape = JSON.stringify(panels.map(({ heading, rows, buttons }) => [heading, rows.map(([name]) => name), buttons]));
    if (shape !== this.shape) {
      $("app-panels").replaceChildren(...panels.map((panel) => this.createCard(panel)));
      this.setReady(this.isReady);
    }
    this.shape = shape; // a pressed button must survive a change of values
    const values = panels.flatMap(({ rows }) => rows.map(([, value]) => value));
    $("app-panels").querySelectorAll("dd").forEach((element, i) => setText(element, values[i]));
  }

  // Called with every status: a button starts a motion only if nothing else moves the arm.
  setReady(isReady) {
    this.isReady = isReady;
    for (const button of $("app-panels").querySelectorAll("button")) button.disabled = !isReady;
  }

  createCard({ heading, rows, buttons }) {
    const list = createElement("dl", { class: "leader-lag" });
    list.append(...rows.flatMap(([name]) => [createElement("dt", {}, name), createElement("dd")]));
    const row = createElement("div", { class: "row-buttons" });
    row.append(...buttons.map((text) => this.createButton(heading, text)));
    const card = createElement("section", { class: "card" });
    card.append(createElement("h2", {}, heading), list, row);
    return card;
  }

  createButton(heading, text) {
    const button = createElement("button", { class: "ghost small", type: "button" }, text);
    button.onclick = () => this.send("run_panel_motion", { heading, button: text });
    return button;
  }
}
