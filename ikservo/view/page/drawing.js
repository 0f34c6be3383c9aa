// Puts the items of a scene on the canvas. All geometry is the server's; here are only colours.

// style: [fill, stroke, width, dash]; names of colours are those of style.css without --draw-.
const STYLES = {
  floor: ["floor", "floor-edge", 1],
  grid: [null, "grid", 1],
  reach: ["reach", "reach-edge", 1],
  keep_out: ["keep-out", "bad", 1],
  picked: ["keep-out", "bad", 2],
  ghost: ["ghost", "ghost-edge", 1.25],
  measured: ["link", "link-edge", 1.25],
  hover: ["link-hover", "link-edge", 1.25],
  grabbed: ["link-hover", "link-edge", 1.5],
  behind: ["ghost", "tip", 1.5],
  limit: [null, "range", 3],
  amber: [null, "warn", 3.5],
  red: [null, "bad", 4],
  needle: [null, "needle", 2],
  hub: ["joint", "needle", 1.75],
  joint: ["joint", "step", 1.75],
  trace: [null, "step", 1.5, [2, 4]],
  iteration: [null, "step-faint", 1.25],
  iterate: [null, "step", 2.25],
  tip: ["joint", "tip", 2.25],
  gap: [null, "bad", 1.5, [3, 4]],
  nearest: [null, "bad", 2],
  target: [null, "good", 2.25],
  target_far: [null, "bad", 2.25],
  scale: ["text", "text", 1.5],
};
const FALLBACK = [null, "text", 1.5];
const FILLED = new Set(["polygon", "circle"]);

// Two sheets: what stands still lies on the lower one and is painted only when it changes.
export class Drawing {
  constructor(canvas, behind) {
    this.canvas = canvas;
    this.sheets = [{ canvas: behind, items: [] }, { canvas, items: [] }];
    for (const sheet of this.sheets) sheet.pen = sheet.canvas.getContext("2d");
    this.readColours();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.readColours());
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    this.colours = new Proxy({}, {
      get: (known, name) => (known[name] ??= style.getPropertyValue(`--draw-${name}`).trim() || style.getPropertyValue(`--${name}`).trim()),
    });
    this.font = `500 12px ${getComputedStyle(document.body).fontFamily}`;
    this.sheets.forEach((sheet) => this.paint(sheet));
  }

  fit() {
    const ratio = devicePixelRatio;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((side) => Math.round(side * ratio));
    if (this.canvas.width === width && this.canvas.height === height) return;
    for (const sheet of this.sheets) {
      Object.assign(sheet.canvas, { width, height });
      this.paint(sheet);
    }
  }

  show(backdrop, items) {
    const [lower, upper] = this.sheets;
    if (backdrop) this.paint(Object.assign(lower, { items: backdrop }));
    this.paint(Object.assign(upper, { items }));
  }

  paint({ canvas, pen, items }) {
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    pen.lineJoin = pen.lineCap = "round";
    pen.font = this.font;
    for (const item of items) this.one(pen, item);
  }

  one(pen, item) {
    const { colours } = this;
    const [fill, stroke, width, dash] = STYLES[item.style] ?? FALLBACK;
    if (item.kind === "text") {
      pen.fillStyle = colours[fill ?? stroke];
      pen.fillText(item.text, item.at[0], item.at[1]);
      return;
    }
    pen.setLineDash(dash ?? []);
    const path = (item.path ??= PATHS[item.kind]?.(item));
    if (!path) return;
    const filled = fill && FILLED.has(item.kind);
    const outlined = filled && item.kind === "polygon";
    if (stroke) {
      pen.strokeStyle = colours[stroke];
      pen.lineWidth = outlined ? 2 * width : width;
      pen.stroke(path);
    }
    if (!filled) return;
    if (outlined) {
      // Rings overlap: what lies under the shape is taken away, so that only the rim is stroked.
      pen.save();
      pen.globalCompositeOperation = "destination-out";
      pen.fillStyle = "#000";
      pen.fill(path, "nonzero");
      pen.restore();
    }
    pen.fillStyle = colours[fill];
    pen.fill(path, "nonzero");
  }
}

const PATHS = {
  polygon({ rings, style }) {
    const path = new Path2D();
    for (const ring of rings) line(path, style === "reach" ? smooth(ring) : ring).closePath();
    return path;
  },
  polyline: ({ points }) => line(new Path2D(), points),
  circle({ at: [x, y], r }) {
    const path = new Path2D();
    path.arc(x, y, r, 0, 2 * Math.PI);
    return path;
  },
  cross({ at: [x, y], r }) {
    const path = new Path2D();
    line(path, [[x - r, y], [x + r, y]]);
    return line(path, [[x, y - r], [x, y + r]]);
  },
};

// The border of the reachable region is known to a few pixels only: its steps mean nothing.
const SMOOTHING = 4;

function smooth(ring) {
  const n = ring.length;
  if (n < 8 * SMOOTHING) return ring;
  return ring.map((_, i) => {
    let [x, y] = [0, 0];
    for (let k = -SMOOTHING; k <= SMOOTHING; k++) {
      const [u, v] = ring[(i + k + n) % n];
      x += u;
      y += v;
    }
    return [x / (2 * SMOOTHING + 1), y / (2 * SMOOTHING + 1)];
  });
}

function line(path, points) {
  points.forEach(([x, y], i) => (i ? path.lineTo(x, y) : path.moveTo(x, y)));
  return path;
}
