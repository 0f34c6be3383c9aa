// A new arm: the dialogue of `ikservo arms new` from the server, question by question.

import { $, createElement } from "./elements.js";

export class NewArm {
  constructor(send) {
    this.send = send;
    this.shown = "null";
    this.hasServos = false; // whether the dialogue may be moving a servo at present
    $("new-arm-form").onsubmit = (event) => {
      event.preventDefault();
      this.send("new_arm", { name: $("new-arm-name").value, source: $("new-arm-source").value, port: $("new-arm-port").value });
    };
  }

  show(dialogue) {
    const fingerprint = JSON.stringify(dialogue ?? null);
    if (fingerprint === this.shown) return;
    this.shown = fingerprint;
    this.hasServos = Boolean(dialogue?.has_servos);
    $("new-arm").hidden = !dialogue;
    $("new-arm-start").disabled = Boolean(dialogue) && !isOver(dialogue);
    $("new-arm").replaceChildren(...(dialogue ? this.createParts(dialogue) : []));
    $("new-arm").querySelector("ul")?.scrollTo(0, 1e6); // scroll to the latest line
    if (dialogue?.question) $("new-arm").querySelector("form :is(input, select, button)").focus();
  }

  createParts(dialogue) {
    const { lines, progress, question, folders, error } = dialogue;
    const over = isOver(dialogue);
    return [
      createElement("ul", {}, ...lines.map((line) => createElement("li", {}, line))),
      createElement("p", { class: error ? "error" : "quiet", role: "status" }, error || resultText(folders) || progress),
      question && this.createQuestion(dialogue),
      this.hasServos && createElement("button", { type: "button", class: "stop small", onclick: () => this.send("stop_arms", { name: null }) }, "Stop all"),
      createElement("button", { type: "button", class: "ghost small", onclick: () => this.send("cancel_new_arm") }, over ? "Done" : "Leave"),
    ].filter(Boolean);
  }

  createQuestion({ question, number }) {
    const answer = (text) => this.send("answer_new_arm", { number, answer: text });
    const form = createElement("form", {}, createElement("p", {}, question.text));
    for (const [word, label] of question.buttons) form.append(createElement("button", { type: "button", class: "ghost small", onclick: () => answer(word) }, label));
    if (question.buttons.length) return form;
    const entry = question.choices.length
      ? createElement("select", { "aria-label": question.text }, ...question.choices.map((choice) => createElement("option", { value: choice, selected: choice === question.default }, choice)))
      : createElement("input", { "aria-label": question.text, value: question.default, autocomplete: "off" });
    form.append(entry, createElement("button", { class: "primary small" }, "Answer"));
    form.onsubmit = (event) => { event.preventDefault(); answer(entry.value); };
    return form;
  }
}

export function isOver({ folders, error }) { return folders.length > 0 || error !== ""; }

export function resultText(folders) {
  return folders.length ? `Written to ${folders.join(", ")}. Choose it above, on port sim.` : "";
}
