// Buttons that record episodes of a data set, shown if the page was started with --record.

const PULSES = { idle: 60, recording: 150, ended: 400 }; // for a controller, in ms

import { ask } from "./confirm.js";
import { $, setText } from "./elements.js";

export class Episode {
  // buzz(ms) lets the held controller vibrate.
  constructor(send, buzz) {
    Object.assign(this, { send, buzz });
    this.state = "idle";
    $("episode-begin").onclick = () => this.request("begin");
    $("episode-save").onclick = () => this.request("save");
    $("episode-discard").onclick = () => ask($("episode-discard"), "Sure?", () => this.request("discard"));
  }

  request(action) {
    this.send("record_episode", { action });
  }

  // For a button of a controller: it begins an episode, and saves it. What ended by itself is decided on the page.
  toggle() {
    const action = { idle: "begin", recording: "save" }[this.state];
    if (!$("episode").hidden && action) this.request(action);
  }

  // Only the page in control may record.
  setReady(isReady) {
    for (const button of $("episode").querySelectorAll("button")) button.disabled = !isReady;
  }

  show({ state, seconds, episodes, text }) {
    const hadFocus = $("episode").contains(document.activeElement);
    const isHeld = ["recording", "ended"].includes(state);
    if (state !== this.state && PULSES[state]) this.buzz(PULSES[state]);
    this.state = state;
    $("episode").hidden = false;
    $("episode").dataset.state = state;
    $("episode-begin").hidden = state !== "idle";
    for (const id of ["episode-save", "episode-discard"]) $(id).hidden = !isHeld;
    if (hadFocus && document.activeElement === document.body) $(isHeld ? "episode-save" : "episode-begin").focus();
    setText($("episode-text"), { idle: `${episodes} saved`, saving: "saving …", recording: `episode ${episodes + 1}` }[state] ?? text);
    setText($("episode-time"), isHeld ? `${seconds} s` : ""); // outside the text, which is read aloud
  }
}
