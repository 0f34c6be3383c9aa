// Age of the shown data: time since the last frame, or since the servos were last read.

import { $, setText } from "./elements.js";

const CHECK_MS = 250;
const SILENT_MS = 1500; // the server sends a scene at least every 100 ms

export class Freshness {
  constructor(onSilent, onHeard) {
    this.onSilent = onSilent;
    this.onHeard = onHeard;
    this.heardAt = performance.now();
    this.readAgeMs = 0; // age of the server's data on the servos
    this.silent = this.lost = false;
    document.addEventListener("visibilitychange", () => { this.heardAt = performance.now(); });
    setInterval(() => this.check(), CHECK_MS);
  }

  heard() {
    this.heardAt = performance.now();
    this.lost = false;
    if (!this.silent) return;
    this.silent = false;
    this.onHeard();
  }

  disconnect() {
    this.lost = true;
    this.silent = false;
  }

  setReadAge(seconds) {
    this.readAgeMs = 1000 * seconds;
  }

  check() {
    const hidden = document.visibilityState === "hidden"; // the server sends nothing to a page that does not draw
    const silentMs = hidden ? 0 : performance.now() - this.heardAt;
    if (!this.lost && !this.silent && silentMs > SILENT_MS) {
      this.silent = true;
      this.onSilent();
    }
    const ageMs = this.lost || this.silent ? silentMs + this.readAgeMs : this.readAgeMs;
    document.body.toggleAttribute("data-old", ageMs >= 1000);
    setText($("age"), ageMs >= 1000 ? `the shown state is ${formatAge(ageMs / 1000)} old` : "");
  }
}

function formatAge(seconds) {
  return seconds < 120 ? `${Math.floor(seconds)} s` : `${Math.floor(seconds / 60)} min`;
}
