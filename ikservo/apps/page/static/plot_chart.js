// One chart: a quantity of several joints over the last seconds.

import { createElement } from "./elements.js";

const HEIGHT = 150;
const COLOURS = 8; // --plot-0 and so on in the style sheet

export class PlotChart {
  constructor(Plot, title, columns, message, joints) {
    this.columns = columns;
    this.span = message.span_s;
    this.series = columns.map((column) => message.series[column]);
    this.times = message.times;
    this.values = columns.map((column) => message.values[column]);
    const { unit } = this.series[0];
    const mixed = this.series.some((each) => each.unit !== unit);
    this.title = title;
    this.unit = mixed ? "° or mm" : unit;
    this.element = createElement("figure", { class: "chart", "data-quantity": this.series[0].quantity },
      createElement("figcaption", {}, title, createElement("span", { class: "quiet" }, this.unit && ` ${this.unit}`)));
    this.box = createElement("div", { role: "img" });
    this.element.append(this.box);
    this.plot = new Plot(this.makeOptions(joints), this.data(), this.box);
    this.describe();
  }

  makeOptions(joints) {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    const axis = { stroke: colour("--soft"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "11px system-ui" };
    const lines = this.series.map(({ joint }) => ({
      label: joint || this.title,
      stroke: colour(`--plot-${Math.max(0, joints.indexOf(joint)) % COLOURS}`),
      width: 1.5,
      points: { show: false },
      spanGaps: false,
      value: (_, value) => (value === null ? "–" : `${value}`),
    }));
    return {
      width: 300, height: HEIGHT, pxAlign: 0,
      scales: { x: { time: false, range: () => [-this.span, 0] }, y: { range: (_, low, high) => padded(low, high) } },
      axes: [{ ...axis, size: 26, values: (_, ticks) => ticks.map(formatAgo) }, { ...axis, size: 46 }],
      series: [{ label: "at", value: (_, value) => (value === null ? "–" : `${value.toFixed(2)} s`) }, ...lines],
      cursor: { drag: { x: false, y: false } },
      legend: { live: true },
    };
  }

  // Times relative to the latest sample, and one array of values for each series.
  data() {
    const latest = this.times.at(-1) ?? 0;
    return [this.times.map((time) => time - latest), ...this.values];
  }

  append(message) {
    this.times = this.times.concat(message.times);
    this.values = this.values.map((values, i) => values.concat(message.values[this.columns[i]]));
    const old = this.times.findIndex((time) => time >= this.times.at(-1) - this.span);
    if (old > 0) {
      this.times = this.times.slice(old);
      this.values = this.values.map((values) => values.slice(old));
    }
    this.plot.setData(this.data());
    this.describe();
  }

  // The text for screen readers: the latest values.
  describe() {
    const latest = this.series.map(({ joint }, i) => `${joint} ${this.values[i].findLast((value) => value !== null) ?? "not measured"}`);
    this.box.setAttribute("aria-label", `${this.title} ${this.unit} over ${this.span} s; latest: ${latest.join(", ")}`);
  }

  fit(width) {
    if (width > 60) this.plot.setSize({ width: Math.floor(width), height: HEIGHT });
  }

  destroy() { this.plot.destroy(); }
}

function padded(low, high) {
  if (low === null) return [0, 1];
  const margin = Math.max((high - low) * 0.08, Math.abs(high) * 1e-3, 0.05);
  return [low - margin, high + margin];
}

function formatAgo(seconds) {
  return Math.abs(seconds) >= 120 ? `${seconds / 60} min` : `${seconds} s`;
}
