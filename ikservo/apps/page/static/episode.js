// Buttons that record episodes of a data set, shown if the page was started with --record.

import { $, setText } from "./elements.js";

export class Episode {
  constructor(send) {
    this.send = send;
    this.state = "idle";
    $("episode-begin").onclick = () => this.request("begin");
    $("episode-save").onclick = () => this.request("save");
    $("episode-discard").onclick = () => this.request("discard");
  }

  request(action) {
    this.send("record_episode", { action });
  }

  // For a button of a controller, which begins an episode and saves it.
  toggle() {
    if (!$("episode").hidden) this.request(this.state === "idle" ? "begin" : "save");
  }

  show({ state, seconds, episodes, text }) {
    this.state = state;
    const isHeld = ["recording", "ended"].includes(state);
    $("episode").hidden = false;
    $("episode").dataset.state = state;
    $("episode-begin").hidden = state !== "idle";
    for (const id of ["episode-save", "episode-discard"]) $(id).hidden = !isHeld;
    const count = { idle: `${episodes} saved`, saving: "saving …" }[state] ?? `episode ${episodes}: ${seconds} s`;
    setText($("episode-text"), `${text} ${count}`.trim());
  }
}
