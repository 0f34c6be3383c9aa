// The posture to lean towards where the target leaves freedom: a pose, and a weight for each joint.

import { $, choices, make, rows, setAttribute, setText } from "./elements.js";

const NONE = "none";
const WORDS = { none: "None", here: "As it stands now" };
const title = (word) => WORDS[word] ?? word[0].toUpperCase() + word.slice(1).replaceAll("_", " ");

export class Preference {
  constructor(say) {
    this.say = say;
    this.pose = NONE;
    this.weights = {};
  }

  arm(arm) {
    this.joints = arm.chain;
    this.poses = [NONE, "here", ...arm.poses];
  }

  show({ pose, weights, note }, mine) {
    this.pose = pose;
    this.weights = weights;
    choices($("preferred"), this.poses, pose, (name) => this.prefer(name, this.weights), title);
    setText($("preferred-now"), title(pose).toLowerCase());
    setText($("preferred-note"), note);
    $("weights").hidden = pose === NONE;
    rows($("weights"), pose === NONE ? [] : this.joints, () => this.row(), (row, joint) => {
      const weight = weights[joint] ?? 1;
      row.joint = joint;
      setText(row.name, joint);
      setText(row.value, weight.toFixed(1));
      setAttribute(row.slider, "aria-label", `How strongly ${joint} leans towards the posture`);
      row.slider.disabled = !mine;
      if (document.activeElement !== row.slider) row.slider.value = weight;
    });
    for (const button of $("preferred").children) button.disabled = !mine;
  }

  row() {
    const row = { name: make("span"), value: make("span") };
    row.slider = make("input", { type: "range", min: 0, max: 1, step: 0.1, oninput: () => this.prefer(this.pose, { ...this.weights, [row.joint]: Number(row.slider.value) }) });
    row.element = make("li", {}, row.name, row.slider, row.value);
    return row;
  }

  prefer(pose, weights) {
    this.say("prefer", { pose, weights });
  }
}
