// The stop button: shows whether a stop can be sent, was sent, or was not confirmed.

import { $, setText } from "./elements.js";

const CONFIRM_MS = 1000;

export class StopButton {
  constructor(send, showRefusal) {
    this.send = send;
    this.showRefusal = showRefusal;
    this.sentAt = null;
    this.count = this.countBefore = 0; // completed stops of the server: now, and when a stop was sent
    $("stop").onclick = () => this.press("button");
  }

  // by names what was pressed: "button", or the key "Space" or "Escape".
  press(by) {
    if ($("stop").disabled) return;
    this.send("stop", { by });
    this.countBefore = this.count;
    const sentAt = (this.sentAt = performance.now());
    setText($("stop-word"), "Stopping …");
    setTimeout(() => this.sentAt === sentAt && this.sayUnconfirmed(), CONFIRM_MS);
  }

  sayUnconfirmed() {
    this.sentAt = null;
    setText($("stop-word"), "Stop again");
    this.showRefusal({ message: "The stop was sent and not confirmed.", hint: "Press it again, or switch off the arm's power." });
  }

  // Called with every status. A stop of a limp arm does not change its mode.
  show({ mode, stop_count }) {
    $("stop").disabled = false; // any client may stop the arm
    this.count = stop_count;
    if (this.sentAt !== null && mode !== "stopped" && stop_count === this.countBefore) return;
    this.sentAt = null;
    setText($("stop-word"), "Stop");
  }

  // There is no connection: a stop cannot be sent.
  disconnect() {
    this.sentAt = null;
    $("stop").disabled = true;
    setText($("stop-word"), "Cannot stop");
  }
}
