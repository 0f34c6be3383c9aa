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
    $("dialogue").replaceChildren(...(dialogue ? this.createParts(dialogue) : []));
    $("dialogue").querySelector("ul")?.scrollTo(0, 1e6); // scroll to the latest line
    if (dialogue?.question) $("dialogue").querySelector("form :is(input, select, button)").focus();
    if (dialogue && (dialogue.question || isOver(dialogue))) $("dialogue").lastElementChild.scrollIntoView({ block: "nearest" });
  }

  createParts(dialogue) {
    const { lines, progress, question, result, error } = dialogue;
    const over = isOver(dialogue);
    return [
      createElement("ul", {}, ...lines.map((line) => createElement("li", {}, line))),
      createElement("p", { class: error ? "error" : "quiet", role: "status" }, error || result || progress),
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

export function isOver({ result, error }) { return result !== "" || error !== ""; }
