// The program of steps: capture, order, save, check and play them.
// The server keeps the program; steps have permanent numbers.

import { ask } from "./confirm.js";
import { $, createElement, setAttribute, setText, updateChoices } from "./elements.js";
import { parseNumber } from "./number_field.js";

const SPEEDS = ["slow", "normal", "fast"];
const UNTIL_STOPPED = "until stopped";
const NAME = /^[A-Za-z0-9_-]{1,64}$/;
const formatTitle = (name) => name[0].toUpperCase() + name.slice(1);

export class Program {
  constructor(send, refuse) {
    this.send = send;
    this.refuse = refuse;
    this.steps = [];
    this.state = { phase: "idle", step: null, reason: "", left: "", problems: [] };
    this.from = null; // number of the step to begin with; null for the first one
    this.path = "joints";
    this.movable = false;
    this.bind();
  }

  bind() {
    const add = (id, fields) => { $(id).onclick = () => this.send("add_step", fields()); };
    add("add-arm", () => ({ what: "arm", path: this.path }));
    add("add-target", () => ({ what: "target", path: this.path }));
    add("add-grid", () => ({ what: "grid", path: this.path }));
    add("add-open", () => ({ what: "open" }));
    add("add-close", () => ({ what: "close" }));
    add("add-wait", () => ({ what: "wait" }));
    add("add-pause", () => ({ what: "pause" }));
    for (const what of ["pose", "recording", "program"]) {
      const list = $(`add-${what}`);
      list.onchange = () => {
        if (list.value) this.send("add_step", { what, [what]: list.value });
        list.value = "";
      };
    }
    $("program").ontoggle = () => $("program").open && $("program").scrollIntoView({ block: "nearest" });
    $("program-show").onclick = () => this.bringIntoSight();
    $("record-step").onclick = () => this.send("record_step", { on: !this.state.recording });
    for (const action of ["check", "play", "step"]) $(`program-${action}`).onclick = () => this.send("run_program", { action, step: this.from });
    $("program-pause").onclick = () => this.send("run_program", { action: "pause" });
    $("program-repeat").onchange = () => this.sendOptions({});
    $("program-save").onclick = () => this.save();
    $("program-new").onclick = () => this.confirmLoss($("program-new"), "Lose changes?", () => this.send("program_file", { action: "new" }));
    $("program-load").onclick = () => this.confirmLoss($("program-load"), "Lose changes?", () => this.send("program_file", { action: "load", name: $("program-files").value }));
  }

  // Called from the picture, which may be far above the program.
  bringIntoSight() {
    const program = $("program");
    program.open = true;
    program.scrollIntoView({ block: "start" });
    program.querySelector("summary").focus({ preventScroll: true });
  }

  setArm({ poses, gripper }) {
    $("add-pose").replaceChildren(createElement("option", { value: "" }, "+ Pose …"), ...poses.map((name) => createElement("option", { value: name }, name)));
    for (const id of ["add-open", "add-close"]) $(id).hidden = !gripper;
    this.showPath();
  }

  showPath() {
    updateChoices($("step-path"), ["joints", "line"], this.path, (path) => { this.path = path; this.showPath(); }, formatTitle);
  }

  sendOptions({ speed = this.program.speed }) {
    const words = $("program-repeat").value.trim();
    const repeat = words === UNTIL_STOPPED ? words : parseNumber(words);
    if (repeat !== UNTIL_STOPPED && !(Number.isInteger(repeat) && repeat >= 1)) {
      this.refuse(`“${words.slice(0, 20)}” is not a number of repetitions. Give a whole number from 1, or: ${UNTIL_STOPPED}`);
      $("program-repeat").value = this.program.repeat;
    } else this.send("set_program", { speed, repeat });
  }

  save() {
    const name = $("program-name").value.trim();
    if (!NAME.test(name)) return this.refuse(`“${name.slice(0, 30)}” cannot be the name of a program: 1 to 64 of the characters A-Z a-z 0-9 _ -`);
    const taken = this.program.names.includes(name) && name !== this.program.name;
    const send = () => this.send("program_file", { action: "save", name, overwrite: taken });
    if (taken) ask($("program-save"), `Replace ${name}?`, send);
    else send();
  }

  confirmLoss(button, question, act) {
    if (this.program.changed && this.steps.length) ask(button, question, act);
    else act();
  }

  // A new program, or a change of it.
  setProgram(program) {
    this.program = program;
    this.steps = program.steps;
    if (!this.steps.some(({ number }) => number === this.from)) this.from = null;
    setText($("program-title"), `${program.name || (this.steps.length ? "not saved" : "")}${program.name && program.changed ? ", changed" : ""}`);
    if (document.activeElement !== $("program-name")) $("program-name").value = program.name || $("program-name").value;
    updateChoices($("program-speed"), SPEEDS, program.speed, (speed) => this.sendOptions({ speed }), formatTitle);
    $("program-repeat").value = program.repeat;
    $("program-files").replaceChildren(...program.names.map((name) => createElement("option", { value: name, selected: name === program.name }, name)));
    setText($("program-folder"), `Kept in ${program.folder}; to run one in a terminal: ikservo program run FILE`);
    for (const [id, label, names] of [["add-recording", "+ Recording …", program.recordings], ["add-program", "+ Program …", program.names]]) {
      $(id).replaceChildren(createElement("option", { value: "" }, label), ...names.map((name) => createElement("option", { value: name }, name)));
    }
    this.renderSteps();
    this.update();
  }

  setState(state) {
    this.state = state;
    if (["paused", "stopped", "bad"].includes(state.phase)) this.from = state.step;
    if (state.phase === "done") this.from = null;
    this.update();
  }

  show({ mode, controller }) {
    this.movable = controller === "you" && mode === "preview";
    this.busy = controller === "you" && mode === "busy";
    this.update();
  }

  renderSteps() {
    if (this.dragged) return;
    const focused = document.activeElement?.closest?.("#program-steps li") && { step: document.activeElement.closest("li").dataset.step, part: document.activeElement.dataset.part };
    this.rows = this.steps.map((step, i) => this.createRow(step, i));
    $("program-steps").replaceChildren(...this.rows.map(({ element }) => element));
    if (focused) $("program-steps").querySelector(`li[data-step="${focused.step}"] [data-part="${focused.part}"]`)?.focus();
  }

  createRow({ number, text, title, action, has_speed, speed, wait_s, pause, only_if, grid }, i) {
    const place = i + 1;
    const change = (fields) => this.send("change_step", { step: number, speed, wait_s, pause, only_if, grid: grid && {}, ...fields });
    const part = (name, attributes, content) => createElement("button", { type: "button", "data-part": name, ...attributes }, content);
    const grip = part("grip", { class: "grip", "aria-label": `Move step ${place}: arrow up, arrow down`, title: "Drag, or arrow keys" }, "⠿");
    grip.onpointerdown = (event) => this.startDrag(event, number);
    grip.onkeydown = (event) => this.onGripKey(event, number, i);
    const begin = part("begin", { class: "begin", onclick: () => this.beginWith(number) }, String(place));
    const words = createElement("span", { class: "what", title }, text);
    const remove = part("delete", { class: "step", "aria-label": `Delete step ${place}`, onclick: () => this.send("delete_step", { step: number }) }, "×");
    const reason = createElement("span", { class: "reason", hidden: true });
    const option = action === "wait_s" ? this.createWait(place, wait_s, change) : action === "pause" ? createPause(place, pause, change) : has_speed ? createSpeed(place, speed, change) : null;
    const options = createElement("span", { class: "options" }, ...[option, createCondition(place, only_if, change)].filter(Boolean));
    return { number, place, begin, reason, element: createElement("li", { "data-step": number }, grip, begin, words, options, remove, grid && createGrid(place, grid, change), reason) };
  }

  createWait(place, wait_s, change) {
    const field = createElement("input", { type: "text", inputmode: "decimal", "data-part": "option", "aria-label": `Wait of step ${place}, seconds`, value: wait_s });
    field.onchange = () => {
      const value = parseNumber(field.value);
      if (value > 0 && value <= 3600) change({ wait_s: value });
      else {
        this.refuse(`“${field.value.slice(0, 20)}” is not a waiting time: more than 0 and at most 3600 seconds.`);
        field.value = wait_s;
      }
    };
    return field;
  }

  // The motion of the chosen step is shown from the present position.
  beginWith(number) {
    this.from = this.from === number ? null : number;
    this.send("show_step", { step: this.from });
    this.update();
  }

  onGripKey(event, number, i) {
    const by = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (!by) return;
    event.preventDefault();
    const to = i + by;
    if (to >= 0 && to < this.steps.length) this.send("move_step", { step: number, to });
  }

  // The row follows the pointer through the list; dropping it tells the server.
  startDrag(event, number) {
    if (!this.movable || event.button !== 0) return;
    event.preventDefault();
    const grip = event.currentTarget, row = grip.closest("li"), list = $("program-steps");
    grip.focus();
    list.setPointerCapture(event.pointerId); // a moved row would lose the capture
    this.dragged = row;
    row.classList.add("dragged");
    list.onpointermove = ({ clientY }) => {
      const below = [...list.children].find((other) => other !== row && clientY < other.getBoundingClientRect().top + other.offsetHeight / 2);
      if (row.nextElementSibling !== (below ?? null)) list.insertBefore(row, below ?? null);
    };
    const end = (dropped) => {
      list.onpointermove = list.onpointerup = list.onpointercancel = null;
      row.classList.remove("dragged");
      this.dragged = null;
      const to = [...list.children].indexOf(row);
      if (dropped && this.steps[to]?.number !== number) this.send("move_step", { step: number, to });
      else this.renderSteps();
    };
    list.onpointerup = () => end(true);
    list.onpointercancel = () => end(false);
  }

  // Shows the possible actions, and the present, next or impossible step.
  update() {
    if (!this.program) return;
    const { phase, step, reason, problems, pausing } = this.state;
    const reasons = new Map(problems.map((each) => [each.step, each.reason]));
    const waits = phase === "waiting";
    if (reason && !waits) reasons.set(step, reason);
    const start = this.steps.findIndex(({ number }) => number === this.from);
    const running = ["checking", "playing"].includes(phase);
    for (const control of $("program").querySelectorAll("button, input, select")) control.disabled = !this.movable || running;
    $("program-pause").disabled = !this.busy || !(running || waits) || pausing;
    setText($("program-pause"), pausing ? "Pausing …" : "Pause after step");
    $("record-step").disabled = !(this.movable && !running) && !(this.busy && this.state.recording);
    setAttribute($("record-step"), "aria-pressed", Boolean(this.state.recording));
    setText($("record-step"), this.state.recording ? "End recording" : "Record by hand");
    $("add-recording").disabled ||= !this.program.recordings.length;
    for (const id of ["check", "play", "step", "save"]) $(`program-${id}`).disabled ||= !this.steps.length;
    $("program-load").disabled ||= !this.program.names.length;
    if (waits) $("program-play").disabled = !this.busy;
    setText($("program-play"), waits ? "Continue" : start > 0 ? `Play from ${start + 1}` : "Play");
    setText($("program-state"), this.describe());
    setAttribute($("program-state"), "class", phase);
    setText($("program-left"), this.state.left);
    for (const row of this.rows) {
      const here = row.number === step;
      const state = here && (running || waits) ? "now" : reasons.has(row.number) ? "bad" : row.number === this.from ? "next" : "";
      if (state === "now" && row.element.className !== state && $("program").open) this.reveal(row.element);
      if (!this.dragged) setAttribute(row.element, "class", state);
      setAttribute(row.begin, "aria-pressed", row.number === this.from);
      setAttribute(row.begin, "aria-label", `Begin with step ${row.place}, and show its motion`);
      row.reason.hidden = !reasons.has(row.number);
      setText(row.reason, reasons.get(row.number) ?? "");
    }
  }

  reveal(row) {
    const list = $("program-steps");
    list.scrollTop = Math.max(row.offsetTop - list.offsetTop - list.clientHeight + row.offsetHeight, Math.min(list.scrollTop, row.offsetTop - list.offsetTop));
  }

  describeProblems() {
    const places = this.state.problems.map((each) => this.steps.findIndex(({ number }) => number === each.step) + 1);
    return places.length > 1 ? `Steps ${places.join(", ")}` : `Step ${places[0]}`;
  }

  describe() {
    const { phase, step, repetition, reason } = this.state;
    const at = this.steps.findIndex(({ number }) => number === step) + 1;
    const { repeat } = this.program;
    const round = repeat === UNTIL_STOPPED ? `, time ${repetition}` : repeat > 1 ? `, time ${repetition} of ${repeat}` : "";
    switch (phase) {
      case "checking": return `Checks step ${at} of ${this.steps.length}`;
      case "ok": return "Checked: every step is possible";
      case "playing": return `Step ${at} of ${this.steps.length}${round}`;
      case "waiting": return `Step ${at}${round}: ${reason} Then press Continue.`;
      case "paused": return `Paused before step ${at}${round}`;
      case "stopped": return `Stopped in step ${at}`;
      case "bad": return `${this.describeProblems()} cannot be carried out; nothing moved`;
      case "done": return "Done";
      default: return this.steps.length ? "" : "No steps yet. Move the arm or its target, then add the position as a step. Save the program under a name to run it later.";
    }
  }
}

function createPause(place, pause, change) {
  const field = createElement("input", { type: "text", class: "pause", maxlength: 80, "data-part": "option", "aria-label": `What to do in step ${place}`, value: pause });
  field.onchange = () => (field.value.trim() ? change({ pause: field.value.trim() }) : (field.value = pause));
  return field;
}

// The server checks the fields as in a program file, and takes a corner from the present tip.
function createGrid(place, grid, change) {
  const parse = (text, unit) => (Number.isFinite(Number(text || NaN)) ? Number(text) / unit : text);
  const field = (key, title, shown, read) => createElement("input", { type: "text", "data-part": key, title, "aria-label": `${title}, step ${place}`, value: shown, onchange: ({ target }) => {
    change({ grid: { [key]: read(target.value.trim()) } });
    target.value = shown; // until the server has accepted the new value
  } });
  const count = (key, title) => field(key, title, grid[key], (text) => parse(text, 1));
  const distance = (key, title) => field(key, title, grid[key].map((m) => Number((1000 * m).toFixed(2))).join(", "), (text) => text.split(/[,;\s]+/).map((mm) => parse(mm, 1000)));
  const corner = (key, label, title) => createElement("button", { type: "button", class: "ghost small", "data-part": `corner-${key}`, title, "aria-label": `${title}, step ${place}`, onclick: () => change({ corner: key }) }, label);
  return createElement("div", { class: "grid", role: "group", "aria-label": `Grid of step ${place}` },
    "Rows", count("rows", "Number of rows, 1 to 30"), distance("row_m", "From one row to the next: x, y, z in mm"), createElement("span", {}, "mm"),
    "Columns", count("columns", "Number of columns, 1 to 30"), distance("column_m", "From one column to the next: x, y, z in mm"), createElement("span", {}, "mm"),
    createElement("div", { class: "corners" }, "Tip is at",
      corner("tip_m", "First place", "The tip is at the first place of the first row"),
      corner("row_m", "Last row", "The tip is at the first place of the last row"),
      corner("column_m", "Last column", "The tip is at the last place of the first row")));
}

function createSpeed(place, speed, change) {
  const options = ["", ...SPEEDS].map((name) => createElement("option", { value: name, selected: name === (speed ?? "") }, name || "as all"));
  return createElement("select", { "data-part": "option", "aria-label": `Speed of step ${place}`, onchange: (event) => change({ speed: event.target.value || null }) }, ...options);
}

// Whether the step depends on what the gripper held when it last moved.
function createCondition(place, condition, change) {
  const options = ["", "grasped", "not grasped"].map((name) => createElement("option", { value: name, selected: name === (condition ?? "") }, name ? `if ${name}` : "always"));
  return createElement("select", { "data-part": "condition", "aria-label": `Condition of step ${place}`, onchange: (event) => change({ only_if: event.target.value || null }) }, ...options);
}
