// Plots of the last ten minutes of history; the server sends nothing while they are closed.
// After a stop they show its last ten seconds until it is acknowledged; they never open by themselves,
// because the user should look at the arm then.

import { $, createElement, setText, updateChoices } from "./elements.js";
import { PlotChart } from "./plot_chart.js";

const QUANTITIES = {
  position: "Position", goal: "Goal", error: "Error", load: "Load", current: "Current",
  temperature: "Temperature", voltage: "Voltage", round_trip: "Round trip", losses: "Lost replies",
};
const SPANS = { 10: "10 s", 60: "1 min", 600: "10 min", stop: "Last stop" };
const OF_A_STOP = ["error", "load", "voltage"];

export class Plots {
  constructor(send) {
    this.send = send;
    this.joints = [];
    this.quantities = ["position", "error"];
    this.hidden = new Set(); // joints that are not plotted
    this.span = "60";
    this.before = null; // the selection before the stop
    this.stopped = null; // unknown until the first status
    this.hasStop = false;
    this.charts = [];
    this.taken = Promise.resolve(); // handles messages one after the other
    $("plots-toggle").onclick = () => (this.open ? this.close() : this.showHere());
    $("plots-close").onclick = () => this.dismiss();
    $("plots-save").onclick = () => send("save_history", { stopped: this.span === "stop" });
    new ResizeObserver(() => this.fit()).observe($("plots-charts"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.open && this.request());
  }

  get open() { return !$("plots").hidden; }

  setArm({ joints }) {
    this.joints = joints;
    this.hidden = new Set();
    if (this.open) this.request(); // a new connection or another arm
  }

  // A stop is selected automatically; the previous selection returns once it is acknowledged.
  showStatus({ mode }) {
    const stopped = mode === "stopped";
    if (stopped && this.stopped === false) this.chooseStop();
    if (!stopped && this.stopped && this.before) this.restore();
    if (stopped && this.stopped === null) this.hasStop = true;
    this.stopped = stopped;
    setText($("plots-toggle"), this.before && !this.open ? "Last stop" : "Plots");
  }

  chooseStop() {
    this.hasStop = true;
    this.before ??= { span: this.span, quantities: this.quantities };
    this.quantities = OF_A_STOP;
    this.span = "stop";
    if (this.open) this.request();
  }

  restore() {
    [this.span, this.quantities] = [this.before.span, this.before.quantities];
    this.before = null;
    if (this.open) this.request();
  }

  show() {
    $("plots").hidden = false;
    $("plots-toggle").setAttribute("aria-expanded", "true");
    this.request();
  }

  // On a phone they are below the picture.
  showHere() {
    this.show();
    $("plots").scrollIntoView({ block: "nearest" });
  }

  close() {
    if (this.before) this.restore();
    else if (this.span === "stop") this.span = "60";
    $("plots").hidden = true;
    $("plots-toggle").setAttribute("aria-expanded", "false");
    this.clear();
    this.send("show_plots", { quantities: [], joints: [] });
  }

  dismiss() {
    if (!this.open) return;
    this.close();
    $("plots-toggle").focus();
  }

  choose(change) {
    this.before = null; // the user has chosen
    Object.assign(this, change);
    this.request();
  }

  request() {
    this.showControls();
    this.send("show_plots", {
      quantities: this.quantities,
      joints: this.joints.filter((joint) => !this.hidden.has(joint)),
      span_s: this.span === "stop" ? 10 : Number(this.span),
      stopped: this.span === "stop",
    });
  }

  showControls() {
    const spans = Object.keys(SPANS).filter((span) => span !== "stop" || this.hasStop);
    updateChoices($("plots-spans"), spans, this.span, (span) => this.choose({ span }), (span) => SPANS[span]);
    fillToggles($("plots-quantities"), Object.entries(QUANTITIES), (name) => this.quantities.includes(name), (name, on) => {
      this.choose({ quantities: on ? [...this.quantities, name] : this.quantities.filter((each) => each !== name) });
    });
    const joints = this.joints.map((joint) => [joint, joint]);
    fillToggles($("plots-joints"), joints, (joint) => !this.hidden.has(joint), (joint, on) => {
      const hidden = new Set(this.hidden);
      if (on) hidden.delete(joint);
      else hidden.add(joint);
      this.choose({ hidden });
    });
    [...$("plots-joints").children].forEach((button, i) => button.classList.add("swatch", `series-${i % 8}`));
  }

  // The first charts wait for their library, and data that arrive wait for the charts.
  receive(message) {
    this.taken = this.taken.then(() => this.take(message));
  }

  async take(message) {
    if (message.series) {
      this.first = message;
      await this.build();
    } else {
      for (const chart of this.charts) chart.append(message);
    }
  }

  async build() {
    const message = this.first;
    if (!message || !this.open) return;
    const { default: Plot } = await import("./uplot.min.js");
    if (message !== this.first || !this.open) return;
    this.clear();
    setText($("plots-reason"), message.reason ? `The last ten seconds before: ${message.reason}` : "");
    for (const quantity of Object.keys(QUANTITIES)) {
      const columns = message.series.flatMap((series, column) => (series.quantity === quantity ? [column] : []));
      if (columns.length) this.charts.push(new PlotChart(Plot, QUANTITIES[quantity], columns, message, this.joints));
    }
    $("plots-charts").replaceChildren(...this.charts.map((chart) => chart.element));
    $("plots-empty").hidden = this.charts.length > 0;
    this.fit();
  }

  fit() {
    for (const chart of this.charts) chart.fit($("plots-charts").clientWidth);
  }

  clear() {
    for (const chart of this.charts) chart.destroy();
    this.charts = [];
    $("plots-charts").replaceChildren();
  }
}

// Toggle buttons that can be reached with Tab.
function fillToggles(group, entries, isOn, toggle) {
  const names = entries.map(([name]) => name).join();
  if (group.dataset.names !== names) {
    group.dataset.names = names;
    group.replaceChildren(...entries.map(([name, label]) => createElement("button", { type: "button", value: name }, label)));
  }
  for (const button of group.children) {
    const on = isOn(button.value);
    button.setAttribute("aria-pressed", on);
    button.onclick = () => toggle(button.value, !on);
  }
}

// A file that the server offers once is fetched like any other file of a page.
export function download({ url, name }) {
  const link = createElement("a", { href: url, download: name });
  link.click();
}
