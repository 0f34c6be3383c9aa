// The preferred posture if the target leaves a choice: a pose, and a weight for each joint.

import { $, createElement, setAttribute, setText, updateChoices, updateRows } from "./elements.js";

const NONE = "none";
const LABELS = { none: "None", here: "As it is now" };
const formatTitle = (name) => LABELS[name] ?? name[0].toUpperCase() + name.slice(1).replaceAll("_", " ");

export class Preference {
  constructor(send) {
    this.send = send;
    this.pose = NONE;
    this.weights = {};
  }

  setArm(armInfo) {
    this.joints = armInfo.chain;
    this.poses = [NONE, "here", ...armInfo.poses];
  }

  show({ pose, weights, note }, inControl) {
    this.pose = pose;
    this.weights = weights;
    updateChoices($("preferred"), this.poses, pose, (name) => this.prefer(name, this.weights), formatTitle);
    setText($("preferred-now"), formatTitle(pose).toLowerCase());
    setText($("preferred-note"), note);
    $("weights").hidden = pose === NONE;
    updateRows($("weights"), pose === NONE ? [] : this.joints, () => this.createRow(), (row, joint) => {
      const weight = weights[joint] ?? 1;
      row.joint = joint;
      setText(row.name, joint);
      setText(row.value, weight.toFixed(1));
      setAttribute(row.slider, "aria-label", `Weight of the preferred posture for ${joint}`);
      row.slider.disabled = !inControl;
      if (document.activeElement !== row.slider) row.slider.value = weight;
    });
    for (const button of $("preferred").children) button.disabled = !inControl;
  }

  createRow() {
    const row = { name: createElement("span"), value: createElement("span") };
    row.slider = createElement("input", { type: "range", min: 0, max: 1, step: 0.1, oninput: () => this.prefer(this.pose, { ...this.weights, [row.joint]: Number(row.slider.value) }) });
    row.element = createElement("li", {}, row.name, row.slider, row.value);
    return row;
  }

  prefer(pose, weights) {
    this.send("prefer", { pose, weights });
  }
}
