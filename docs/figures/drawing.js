// A plane in metres, drawn as SVG: x to the right, y upwards. Nothing is loaded from elsewhere.

const NS = "http://www.w3.org/2000/svg";

function element(name, attributes) {
  const made = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

/** A drawing that is cleared and drawn anew for each change. */
export class Plane {
  /** @param {HTMLElement} figure  @param {number[]} box  x, y of the lower left corner, width, height in metres */
  constructor(figure, box, widthPx = 520) {
    [this.x, this.y, this.width, this.height] = box;
    this.scale = widthPx / this.width;
    const heightPx = this.height * this.scale;
    this.svg = element("svg", { viewBox: `0 0 ${widthPx} ${heightPx}`, width: widthPx, height: heightPx });
    this.layer = element("g", {});
    this.svg.append(this.layer);
    figure.append(this.svg);
  }

  clear() {
    this.layer.replaceChildren();
  }

  pixels([x, y]) {
    return [(x - this.x) * this.scale, (this.y + this.height - y) * this.scale];
  }

  metres(event) {
    const box = this.svg.getBoundingClientRect();
    const shown = box.width / this.width; // the page may show it smaller than it was drawn
    return [this.x + (event.clientX - box.left) / shown, this.y + this.height - (event.clientY - box.top) / shown];
  }

  add(name, attributes) {
    const made = element(name, attributes);
    this.layer.append(made);
    return made;
  }

  line(points, colour, width = 2, dash = "") {
    const text = points.map((point) => this.pixels(point).join(",")).join(" ");
    return this.add("polyline", {
      points: text, fill: "none", stroke: colour, "stroke-width": width, "stroke-dasharray": dash,
      "stroke-linecap": "round", "stroke-linejoin": "round",
    });
  }

  polygon(points, colour, fill) {
    const made = this.line([...points, points[0]], colour, 1.5);
    made.setAttribute("fill", fill);
    return made;
  }

  circle(centre, radius, colour, { fill = "none", dash = "", width = 1 } = {}) {
    const [cx, cy] = this.pixels(centre);
    return this.add("circle", {
      cx, cy, r: radius * this.scale, stroke: colour, fill, "stroke-dasharray": dash, "stroke-width": width,
    });
  }

  dot(point, colour, radiusPx = 5) {
    const [cx, cy] = this.pixels(point);
    return this.add("circle", { cx, cy, r: radiusPx, fill: colour });
  }

  arrow(from, to, colour) {
    const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
    const head = 8 / this.scale;
    const side = (turn) => [to[0] - head * Math.cos(angle + turn), to[1] - head * Math.sin(angle + turn)];
    this.line([from, to], colour, 2);
    this.line([side(0.4), to, side(-0.4)], colour, 2);
  }

  text(at, words, colour = "currentColor") {
    const [x, y] = this.pixels(at);
    const made = this.add("text", { x: x + 6, y: y - 6, fill: colour, "font-size": 13 });
    made.textContent = words;
  }

  cross(at, colour) {
    const r = 7 / this.scale;
    this.line([[at[0] - r, at[1]], [at[0] + r, at[1]]], colour, 3);
    this.line([[at[0], at[1] - r], [at[0], at[1] + r]], colour, 3);
  }

  /** Draw an arm of points from base to tip. */
  arm(points, colour, { dash = "", width = 7 } = {}) {
    this.line(points, colour, width, dash);
    points.slice(0, -1).forEach((point) => this.dot(point, "var(--md-default-bg-color, white)", 4));
  }

  /** Call `moved` with the place of the pointer while it is pressed. */
  onDrag(moved, pressed = moved) {
    this.svg.addEventListener("pointerdown", (event) => {
      this.svg.setPointerCapture(event.pointerId);
      pressed(this.metres(event));
    });
    this.svg.addEventListener("pointermove", (event) => {
      if (event.buttons) moved(this.metres(event));
    });
  }
}

/** A line of numbers below the drawing. */
export function addOutput(figure) {
  const made = document.createElement("output");
  figure.append(made);
  return made;
}

export function addButton(figure, words, pressed) {
  const made = document.createElement("button");
  made.textContent = words;
  made.type = "button";
  made.onclick = pressed;
  figure.append(made);
  return made;
}

export function addSlider(figure, words, [low, high, value], changed) {
  const label = document.createElement("label");
  const input = document.createElement("input");
  Object.assign(input, { type: "range", min: low, max: high, step: (high - low) / 200, value });
  input.oninput = () => changed(Number(input.value));
  label.append(`${words} `, input);
  figure.append(label);
  return input;
}

export const COLOURS = { arm: "#3f51b5", other: "#9fa8da", target: "#c62828", help: "#888888", good: "#2e7d32", hit: "#ef6c00" };
export const degrees = (radians) => `${((radians * 180) / Math.PI).toFixed(1)}°`;
export const millimetres = (metres) => `${(metres * 1000).toFixed(1)} mm`;
