// Dialogues without an open arm: a new arm, ids of servos, a check; question by question.

import { $, createElement } from "./elements.js";

const SERVO_TASKS = [["arms-find", "find_servos"], ["arms-setup", "set_up_servos"], ["arms-check", "check_servos"]];
const START_BUTTONS = ["new-arm-start", ...SERVO_TASKS.map(([button]) => button)];

export class ServerDialogue {
  constructor(send) {
    this.send = send;
    this.shown = "null";
    this.movesServos = false; // whether the dialogue may be moving a servo at present
    for (const [button, kind] of SERVO_TASKS) {
      $(button).onclick = () => this.send(kind, { arm: $("arms-model").value, port: $("arms-port").value });
    }
    $("new-arm-form").onsubmit = (event) => {
      event.preventDefault();
      this.send("new_arm", { name: $("new-arm-name").value, source: $("new-arm-source").value, port: $("new-arm-port").value });
    };
  }

  show(dialogue) {
    const fingerprint = JSON.stringify(dialogue ?? null);
    if (fingerprint === this.shown) return;
    this.shown = fingerprint;
    this.movesServos = Boolean(dialogue?.moves_servos);
    $("dialogue").hidden = !dialogue;
    for (const button of START_BUTTONS) $(button).disabled = Boolean(dialogue) && !isOver(dialogue);
    const focused = $("dialogue").contains(document.activeElement) && document.activeElement.textContent;
    $("dialogue").replaceChildren(...(dialogue ? this.createParts(dialogue) : []));
    $("dialogue").querySelector("ul")?.scrollTo(0, dialogue && isOver(dialogue) ? 0 : 1e6); // the latest line, or all of the result
    const same = [...$("dialogue").querySelectorAll("button")].find((button) => button.textContent === focused);
    (dialogue?.question ? $("dialogue").querySelector("form :is(input, select, button)") : same)?.focus({ preventScroll: true });
    if (dialogue && (dialogue.question || isOver(dialogue))) $("dialogue").lastElementChild.scrollIntoView({ block: "nearest" });
  }

  createParts(dialogue) {
    const { lines, progress, question, result, error } = dialogue;
    const over = isOver(dialogue);
    return [
      dialogue.sketch && !over && createSketch(dialogue),
      createElement("ul", {}, ...lines.map((line) => createElement("li", {}, line))),
      createElement("p", { class: error ? "error" : "quiet", role: "status" }, error || result || progress),
      dialogue.share !== null && createElement("progress", { value: dialogue.share, "aria-label": "Done" }),
      question && this.createQuestion(dialogue),
      this.movesServos && createElement("button", { type: "button", class: "stop small", onclick: () => this.send("stop_arms", { name: null }) }, "Stop all"),
      createElement("button", { type: "button", class: "ghost small", onclick: () => this.send("leave_dialogue") }, over ? "Done" : "Leave"),
    ].filter(Boolean);
  }

  createQuestion({ question, number }) {
    const answer = (text) => this.send("answer_dialogue", { number, answer: text });
    const form = createElement("form", {}, createElement("p", {}, question.text));
    for (const [word, label] of question.buttons) form.append(createElement("button", { type: "button", class: "ghost small", onclick: () => answer(word) }, label));
    if (question.buttons.length) return form;
    const entry = question.choices.length
      ? createElement("select", { "aria-label": question.text }, ...question.choices.map((choice) => createElement("option", { value: choice, selected: choice === question.default }, choice)))
      : createElement("input", { "aria-label": question.text, value: question.default, autocomplete: "off" });
    form.append(entry, createElement("button", { class: "primary small" }, "Continue"));
    form.onsubmit = (event) => { event.preventDefault(); answer(entry.value); };
    return form;
  }
}

const ADAPTER_M = [-0.16, 0.02]; // place of the adapter in the sketch

// The arm from its side, with a cable from the adapter to the only servo that is plugged in.
function createSketch({ sketch: { pivots_m, tip_m }, joint }) {
  const pivots = Object.entries(pivots_m);
  const path = (points) => points.map(([x, z], i) => `${i ? "L" : "M"}${x} ${-z}`).join("");
  const bounds = [ADAPTER_M, tip_m, [0, 0], ...pivots.map(([, at]) => at)];
  const [xs, zs] = [bounds.map(([x]) => x), bounds.map(([, z]) => z)];
  const [left, top] = [Math.min(...xs) - 0.04, -Math.max(...zs) - 0.04];
  const svg = createShape("svg", { class: "sketch", role: "img", "aria-label": `Plug in only the servo of ${joint}`, viewBox: `${left} ${top} ${Math.max(...xs) + 0.04 - left} ${0.06 - top}` });
  svg.append(createShape("path", { class: "links", d: path([[0, 0], ...pivots.map(([, at]) => at), tip_m]) }));
  for (const [name, [x, z]] of pivots) svg.append(createShape("circle", { cx: x, cy: -z, r: 0.013, class: name === joint ? "plugged" : "" }));
  const [x, z] = pivots_m[joint] ?? tip_m;
  svg.append(createShape("path", { class: "cable", d: `M${ADAPTER_M[0]} ${-ADAPTER_M[1]}C${ADAPTER_M[0]} ${-z} ${ADAPTER_M[0]} ${-z} ${x} ${-z}` }));
  svg.append(createShape("rect", { x: ADAPTER_M[0] - 0.025, y: -ADAPTER_M[1] - 0.015, width: 0.05, height: 0.03, rx: 0.006 }));
  return svg;
}

function createShape(kind, attributes) {
  const shape = document.createElementNS("http://www.w3.org/2000/svg", kind);
  for (const [name, value] of Object.entries(attributes)) shape.setAttribute(name, value);
  return shape;
}

export function isOver({ result, error }) { return result !== "" || error !== ""; }
