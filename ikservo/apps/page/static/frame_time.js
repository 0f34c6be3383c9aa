// Measures how long the page takes to draw a frame, and lowers the detail of what it draws until that
// is quick enough: a slow page delays heartbeats and presses.

const SLOW_MS = 80; // a slower frame delays the actions of the user
const QUICK_MS = 25;
const FRAMES = 12; // their median is used, because single slow frames mean nothing
const HIDDEN_MS = 5000; // longer times are not frames: the page was hidden, or the computer was asleep
const RETRY_MS = 15000; // time of quick frames before more detail is tried again

// Each level has less detail than the one before.
const LEVELS = [
  { maxRatio: Infinity, shadows: true, swept: true, pause: 0 },
  { maxRatio: 1, shadows: false, swept: true, pause: 0 },
  { maxRatio: 0.5, shadows: false, swept: false, pause: 0 },
  { maxRatio: 0.5, shadows: false, swept: false, pause: 1 }, // a pause as long as the frame before
];

export class FrameTime {
  constructor(onChange) {
    this.onChange = onChange; // called when the detail has changed
    this.level = 0;
    this.retryMs = RETRY_MS;
    this.medianMs = this.slowMs = 0;
    this.begunAt = 0; // when the last frame was begun
    this.restart();
  }

  get detail() { return LEVELS[this.level]; }

  // Pixels of the drawing per pixel of the page.
  get pixelRatio() { return Math.min(devicePixelRatio, this.detail.maxRatio); }

  // Call when the content changes: earlier measurements do not apply to it.
  restart() {
    this.times = [];
    this.drawnAt = null; // when the last frame was begun, if it was drawn
    this.quickSince = null;
  }

  // Called with each animation frame; returns whether it is time to draw the next one.
  tick(now) {
    if (this.drawnAt !== null) this.record(now - this.drawnAt, now);
    const { pause } = this.detail;
    this.drawnAt = null;
    return !pause || now - this.begunAt > 2 * pause * this.medianMs;
  }

  drawn(now) {
    this.drawnAt = this.begunAt = now;
  }

  record(ms, now) {
    if (ms > HIDDEN_MS) return;
    this.times = [...this.times, ms].slice(-FRAMES);
    if (this.times.length < FRAMES) return;
    this.medianMs = [...this.times].sort((a, b) => a - b)[FRAMES / 2];
    if (this.medianMs > SLOW_MS) {
      this.slowMs = Math.round(this.medianMs);
      this.set(Math.min(this.level + 1, LEVELS.length - 1));
    } else if (this.medianMs > QUICK_MS || !this.level) this.quickSince = null;
    else if (now - (this.quickSince ??= now) > this.retryMs) {
      this.retryMs *= 2; // drawing may be quick only with less detail
      this.set(this.level - 1);
    }
  }

  // Describes a drawing that was too slow in a few words; empty if none was.
  describe(what) {
    if (!this.level) return "";
    const isSlowest = this.level === LEVELS.length - 1;
    return `${what} ${isSlowest ? "takes" : "took"} ${this.slowMs} ms per frame: ${isSlowest ? "this computer is too slow for it" : "drawn more coarsely"}`;
  }

  set(level) {
    this.level = level;
    this.restart();
    this.onChange();
  }
}
