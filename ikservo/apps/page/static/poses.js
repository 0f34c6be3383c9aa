// The poses of the arm: buttons if there are few, otherwise a list with a filter.

import { $, createElement } from "./elements.js";

const MAX_BUTTONS = 4;
const ALWAYS = ["rest", "home"];
const formatTitle = (name) => name[0].toUpperCase() + name.slice(1).replaceAll("_", " ");

export class Poses {
  constructor(send) {
    this.send = send;
    this.names = [];
    $("pose-filter").oninput = () => this.showList();
    $("pose-filter").onkeydown = (event) => this.onFilterKey(event);
    $("pose-list").onkeydown = (event) => this.onListKey(event);
    $("pose-close").onclick = () => this.close();
  }

  setArm({ poses }) {
    this.names = poses;
    const few = poses.length <= MAX_BUTTONS ? poses : ALWAYS.filter((name) => poses.includes(name));
    const buttons = few.map((name) => createElement("button", { type: "button", onclick: () => this.go(name) }, formatTitle(name)));
    if (few.length < poses.length) buttons.push(createElement("button", { type: "button", id: "all-poses", "aria-haspopup": "dialog", onclick: () => this.open() }, `All ${poses.length} poses …`));
    $("poses").replaceChildren(...buttons);
    this.showList();
  }

  go(name) {
    this.send("go_to_pose", { name });
  }

  open() {
    $("pose-filter").value = "";
    this.showList();
    this.onOpen();
    $("pose-dialog").show();
    $("pose-filter").focus();
  }

  close() {
    $("pose-dialog").close();
    $("all-poses")?.focus();
  }

  dismiss() {
    if ($("pose-dialog").open) this.close();
  }

  showList() {
    const wanted = $("pose-filter").value.trim().toLowerCase();
    const found = this.names.filter((name) => name.toLowerCase().includes(wanted));
    $("pose-list").replaceChildren(...found.map((name) => createElement("button", { type: "button", value: name, onclick: () => this.go(name) }, name)));
    $("pose-count").textContent = found.length ? `${found.length} of ${this.names.length}` : `No pose is called “${wanted.slice(0, 30)}”.`;
  }

  // Enter selects the first match, arrow down moves into the list.
  onFilterKey(event) {
    const first = $("pose-list").firstElementChild;
    if (!first || !["Enter", "ArrowDown"].includes(event.key)) return;
    event.preventDefault();
    if (event.key === "Enter") first.click();
    else first.focus();
  }

  onListKey(event) {
    const at = [...$("pose-list").children].indexOf(document.activeElement);
    const step = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10, Home: -Infinity, End: Infinity }[event.key];
    if (at < 0 || !step) return;
    event.preventDefault();
    if (at === 0 && event.key === "ArrowUp") return $("pose-filter").focus();
    $("pose-list").children[Math.max(0, Math.min($("pose-list").children.length - 1, at + step))].focus();
  }
}
