// Paints items in pixels, see picture.js, on the canvas; only this file knows colours.

// style: [fill, stroke, width, dash]; names of colours are those of style.css without --draw-.
const STYLES = {
  floor: ["floor", "floor-edge", 1],
  grid: [null, "grid", 1],
  reach: ["reach", "reach-edge", 1],
  keep_out: ["keep-out", "text", 1],
  picked: ["keep-out", "text", 2],
  ghost: ["ghost", "ghost-edge", 1.25],
  swept: ["swept", null],
  refused: ["refused", "bad", 1.25],
  touching: ["touching", "bad", 2.5],
  measured: ["link", "link-edge", 1.25],
  hover: ["link-hover", "link-edge", 1.25],
  grabbed: ["link-hover", "link-edge", 1.5],
  outline: ["clear", "live", 1.25],
  outline_hover: ["ghost", "live", 1.5],
  outline_grabbed: ["ghost", "live", 2],
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
  planned: [null, "ghost-edge", 1.5, [1, 5]],
  travelled: [null, "tip", 1.5],
  gap: [null, "bad", 1.5, [3, 4]],
  nearest: [null, "bad", 2],
  target: [null, "good", 2.25],
  target_far: [null, "bad", 2.25],
  target_refused: [null, "bad", 2.25],
  scale: ["text", "text", 1.5],
};
const FALLBACK = [null, "text", 1.5];
const FILLED = new Set(["polygon", "circle"]);

// Two layers: the lower one has the static backdrop and is painted only when it changes.
export class Drawing {
  constructor(canvas, backdropCanvas) {
    this.canvas = canvas;
    this.ratio = devicePixelRatio;
    this.layers = [{ canvas: backdropCanvas, items: [] }, { canvas, items: [] }];
    for (const layer of this.layers) layer.context = layer.canvas.getContext("2d");
    this.readColours();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.readColours());
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    this.colours = new Proxy({}, {
      get: (cached, name) => (cached[name] ??= style.getPropertyValue(`--draw-${name}`).trim() || style.getPropertyValue(`--${name}`).trim()),
    });
    this.font = `500 12px ${getComputedStyle(document.body).fontFamily}`;
    this.layers.forEach((layer) => this.paint(layer));
  }

  // The ratio is canvas pixels per page pixel.
  fit(ratio = devicePixelRatio) {
    this.ratio = ratio;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((side) => Math.round(side * ratio));
    if (this.canvas.width === width && this.canvas.height === height) return;
    for (const layer of this.layers) {
      Object.assign(layer.canvas, { width, height });
      this.paint(layer);
    }
  }

  show(backdrop, items) {
    const [lower, upper] = this.layers;
    if (backdrop && backdrop !== lower.items) this.paint(Object.assign(lower, { items: backdrop }));
    if (items !== upper.items) this.paint(Object.assign(upper, { items }));
  }

  paint({ canvas, context, items }) {
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.lineJoin = context.lineCap = "round";
    context.font = this.font;
    for (const item of items) this.paintItem(context, item);
  }

  paintItem(context, item) {
    const { colours } = this;
    const [fill, stroke, width, dash] = STYLES[item.style] ?? FALLBACK;
    if (item.kind === "text") {
      context.setLineDash([]);
      context.strokeStyle = colours.stage; // a rim makes text readable over any picture
      context.lineWidth = 4;
      context.strokeText(item.text, item.at[0], item.at[1]);
      context.fillStyle = colours[fill ?? stroke];
      context.fillText(item.text, item.at[0], item.at[1]);
      return;
    }
    context.setLineDash(dash ?? []);
    const path = (item.path ??= PATHS[item.kind]?.(item));
    if (!path) return;
    const filled = fill && FILLED.has(item.kind);
    const outlined = filled && stroke && item.kind === "polygon";
    if (stroke) {
      context.strokeStyle = colours[stroke];
      context.lineWidth = outlined ? 2 * width : width;
      context.stroke(path);
    }
    if (!filled) return;
    if (outlined) {
      // Rings overlap: erase the inside of the stroked rings, so that only the outer rim remains.
      context.save();
      context.globalCompositeOperation = "destination-out";
      context.fillStyle = "#000";
      context.fill(path, "nonzero");
      context.restore();
    }
    context.fillStyle = colours[fill];
    context.fill(path, "nonzero");
  }
}

const PATHS = {
  polygon({ rings, style }) {
    const path = new Path2D();
    for (const ring of rings) addLine(path, style === "reach" ? smoothRing(ring) : ring).closePath();
    return path;
  },
  polyline: ({ points }) => addLine(new Path2D(), points),
  circle({ at: [x, y], r }) {
    const path = new Path2D();
    path.arc(x, y, r, 0, 2 * Math.PI);
    return path;
  },
  cross({ at: [x, y], r }) {
    const path = new Path2D();
    addLine(path, [[x - r, y], [x + r, y]]);
    return addLine(path, [[x, y - r], [x, y + r]]);
  },
};

// The border of the reachable region is accurate to a few pixels only: smooth its grid steps.
const SMOOTHING = 4;

function smoothRing(ring) {
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

function addLine(path, points) {
  points.forEach(([x, y], i) => (i ? path.lineTo(x, y) : path.moveTo(x, y)));
  return path;
}
