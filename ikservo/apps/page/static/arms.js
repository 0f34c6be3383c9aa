// The list of arms: open arms, each with its Stop, and arms that can be opened.

import { CameraPicture } from "./camera.js";
import { Connection } from "./connection.js";
import { ServerDialogue } from "./dialogue.js";
import { $, createElement, setText, updateRows } from "./elements.js";

const FIND_MS = 2000; // period of searching ports while the list is shown
const NOTE_MS = 8000;
const STATES = {
  opening: "opening …", closing: "closing …", failed: "not opened", stopped: "stopped",
  live: "live", busy: "moves by itself", calibration: "is calibrated", preview: "preview",
};
const IS_OPEN = new Set(["stopped", "live", "busy", "calibration", "preview"]);

export class Arms {
  constructor(key, options, follow, setOthers, chooseCamera) {
    this.options = options;
    this.follow = follow; // called with the name of an arm that the shown arm should follow
    this.setOthers = setOthers; // called with the names of the open arms beside the one shown
    this.shown = null; // the name of the arm that this page shows
    this.wanted = null; // the arm that was chosen here, shown once it is open
    this.list = [];
    this.connection = new Connection(key, {
      arms: (message) => this.receive(message),
      camera_url: ({ url }) => this.camera.setAddress(url),
      refused: ({ message, hint }) => this.note(`${message} ${hint}`),
      closed: (why, reason) => {
        this.note(why === "full" ? reason : "No connection to `ikservo view`. If it has ended, start it again and open the address that it prints.");
        $("dialogue").inert = true;
        this.camera.drop();
      },
    }, "arms");
    this.camera = new CameraPicture(() => this.send("show_camera", { arm: this.shown }), chooseCamera);
    this.dialogue = new ServerDialogue((kind, fields) => this.send(kind, fields));
    $("arms-toggle").onclick = () => ($("arms").hidden ? this.show() : this.close());
    $("arms-close").onclick = () => this.closeByHand();
    $("stop-all").onclick = () => this.send("stop_arms", { name: null });
    $("stop").addEventListener("click", () => this.dialogue.movesServos && this.send("stop_arms", { name: null }));
    $("arms-form").onsubmit = (event) => {
      event.preventDefault();
      this.openArm($("arms-model").value, $("arms-port").value);
    };
    setInterval(() => !$("arms").hidden && document.visibilityState === "visible" && this.send("find_choices"), FIND_MS);
  }

  send(kind, fields) { this.connection.send(kind, fields); }

  setShown(name) {
    this.shown = name;
    this.update();
  }

  show() {
    this.onOpen();
    $("arms").hidden = false;
    $("arms-toggle").setAttribute("aria-expanded", "true");
    this.send("find_choices");
  }

  close() {
    $("arms").hidden = true;
    $("arms-toggle").setAttribute("aria-expanded", "false");
  }

  // Without an arm, the page shows only the list.
  dismiss() {
    if (this.shown && !$("arms").hidden) this.closeByHand();
  }

  closeByHand() {
    this.close();
    $("arms-toggle").focus();
  }

  // Space and Escape stop all arms if there are several, and the servos of a new arm.
  stopSeveral(by) {
    if (this.list.filter(({ state }) => IS_OPEN.has(state)).length > 1 || this.dialogue.movesServos) this.send("stop_arms", { name: null, by });
  }

  openArm(arm, port) {
    this.wanted = { arm, port, before: new Set(this.list.filter(({ state }) => IS_OPEN.has(state)).map(({ name }) => name)) };
    this.note("");
    this.send("open_arm", { arm, port });
  }

  receive(message) {
    const first = !this.list.length && !this.models;
    this.list = message.arms;
    this.dialogue.show(message.dialogue);
    this.mayControl = message.permission === "control";
    if (first && !$("arms").hidden) this.send("find_choices"); // the list may be shown before the connection
    if (this.list.length) $("arms-model").dataset.chosen ??= this.list[0].name;
    $("dialogue").inert = false;
    const { cameras } = message;
    setText($("arms-none"), cameras.length ? `None yet. The picture of ${cameras.join(" and ")} is shown with an arm: open one.` : "None yet.");
    this.update();
    this.showChoices(message);
    this.showWanted();
  }

  update() {
    const open = this.list.filter(({ state }) => IS_OPEN.has(state));
    this.setOthers(open.map(({ name }) => name).filter((name) => name !== this.shown));
    $("stop-all").hidden = (open.length < 2 && !this.dialogue.movesServos) || !this.mayControl;
    $("arms-none").hidden = this.list.length > 0;
    setText($("arms-toggle"), open.length > 1 ? `Arms (${open.length})` : "Arms");
    this.camera.show(this.list.find(({ name }) => name === this.shown)?.camera);
    updateRows($("arms-open"), this.list, createArmRow, (row, arm) => this.updateArm(row, arm));
  }

  updateArm({ element, title, text, show, follow, stop, close }, { name, title: words, port, state, text: what, hint }) {
    const open = IS_OPEN.has(state);
    element.dataset.state = state;
    element.dataset.arm = name;
    setText(title, `${name} · ${words} on ${port || "its port"}`);
    const known = what.toLowerCase().startsWith(STATES[state]) ? "" : STATES[state];
    setText(text, [known, [what, hint].filter(Boolean).join(" ")].filter(Boolean).join(" – "));
    show.hidden = !open || name === this.shown;
    stop.hidden = !open || state === "stopped";
    setText(close, open ? "Close" : "Remove");
    close.hidden = state === "opening" || state === "closing";
    follow.hidden = show.hidden || !this.shown;
    stop.disabled = close.disabled = follow.disabled = !this.mayControl;
    for (const [button, word] of [[show, "Show"], [follow, "Follow"], [stop, "Stop"], [close, close.textContent]]) button.setAttribute("aria-label", `${word} ${name}`);
    show.onclick = () => this.showArm(name);
    follow.onclick = () => { this.close(); this.follow(name); };
    stop.onclick = () => this.send("stop_arms", { name });
    close.onclick = () => this.send("close_arm", { name });
  }

  // An arm that was chosen here is shown as soon as it is open.
  showWanted() {
    if (!this.wanted) return;
    const { before, arm } = this.wanted;
    const opened = this.list.find(({ name, state }) => IS_OPEN.has(state) && !before.has(name) && name.startsWith(arm));
    if (opened) this.showArm(opened.name);
    else if (!this.list.some(({ state }) => state === "opening")) this.wanted = null;
  }

  // Another arm needs a new page, so that nothing of the previous one is left.
  showArm(name) {
    this.wanted = null;
    this.options.set("arm", name);
    location.hash = this.options.toString();
    location.reload();
  }

  showChoices({ models, ports, own }) {
    $("arms-choose").hidden = !this.mayControl;
    const fingerprint = JSON.stringify([models, ports, own]);
    if (fingerprint === this.models) return;
    this.models = fingerprint;
    fillSelect($("arms-model"), models.map(([name, title]) => [name, `${name} – ${title}`]));
    fillSelect($("arms-port"), ports.map(([name, text]) => [name, text ? `${name} – ${text}` : name]));
    fillSelect($("new-arm-port"), [["", "no servos connected"], ...ports.filter(([name]) => name !== "sim").map(([name, text]) => [name, text ? `${name} – ${text}` : name])]);
    $("arms-own-none").hidden = own.length > 0;
    $("arms-no-port").hidden = ports.length > 1;
    $("arms-own").replaceChildren(...own.map((row) => this.createOwnRow(row)));
  }

  createOwnRow({ arm, adapter, port, state }) {
    const words = `${arm} ${adapter} · ${state} · ${port || "not plugged in"}`;
    const open = createElement("button", { type: "button", class: "ghost small", "aria-label": `Open ${arm} ${adapter}`, disabled: !port, onclick: () => this.openArm(arm, port) }, "Open");
    return createElement("li", {}, createElement("span", {}, words), open);
  }

  note(text) {
    setText($("arms-note"), text);
    clearTimeout(this.noteTimer);
    this.noteTimer = setTimeout(() => setText($("arms-note"), ""), NOTE_MS);
  }
}

function createArmRow() {
  const [title, text] = [createElement("strong"), createElement("span", { class: "quiet" })];
  const [show, follow, stop, close] = ["Show", "Follow …", "Stop", "Close"].map((word) => createElement("button", { type: "button", class: word === "Stop" ? "stop small" : "ghost small" }, word));
  const element = createElement("li", {}, createElement("div", {}, title, text), show, follow, stop, close);
  return { element, title, text, show, follow, stop, close };
}

// Keep the choice if it is still offered. A new adapter replaces the simulator unless a user chose it.
function fillSelect(select, entries) {
  select.onchange ??= () => { select.dataset.chosen = select.value; };
  const chosen = select.dataset.chosen ?? (select.value === "sim" ? null : select.value);
  select.replaceChildren(...entries.map(([value, text]) => createElement("option", { value }, text)));
  if (entries.some(([value]) => value === chosen)) select.value = chosen;
}
