// The servo page: servos on a port, the registers of one servo, and actions on it.

import { ask } from "./confirm.js";
import { Connection } from "./connection.js";
import { $, createElement, setAttribute, setText } from "./elements.js";
import { PlotChart } from "./plot_chart.js";
import { download } from "./plots.js";
import { Servos } from "./servos.js";

const MOST_PLOTTED = 10;
const key = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
let [names, charts, shown, trialChart] = [null, [], null, null];

const connection = new Connection(key, {
  line({ port, text, done, servos: found }) {
    setText($("port"), port);
    setText($("line"), text || describe(found));
    $("progress").hidden = done === null;
    $("progress").value = done ?? 0;
    const joints = found.map(({ name }) => name);
    if (joints.join() === names) return;
    names = joints.join();
    servos.setArm({ joints });
    if (joints.length) servos.read();
  },
  servo(message) {
    shown = message;
    servos.receive(message);
    setAttribute($("torque"), "aria-pressed", message.torque);
    setAttribute($("led"), "aria-pressed", message.registers.some(({ name, raw }) => name === "led" && raw));
    $("led").hidden = !message.led;
    showGains(message);
    $("new-id").value = message.id;
    $("new-rate").replaceChildren(...message.baud_rates.map((rate) => createElement("option", { value: rate, selected: rate === message.baud_rate }, rate)));
  },
  note({ text }) { setText($("note"), text); },
  trial(message) {
    setGains(message.gains);
    drawing = drawing.then(() => drawTrial(message));
  },
  plots(message) { drawing = drawing.then(() => draw(message)); },
  download,
  refused({ message, hint }) { setText($("note"), `${message} ${hint}`); },
  closed(why, reason) {
    names = null;
    setText($("line"), why === "wrong-key" ? "This is not the address that `ikservo view` printed." : reason || "No connection to `ikservo view`.");
  },
}, "bench");
const send = (kind, fields) => connection.send(kind, fields);
const servos = new Servos(send);
servos.showStatus({ controller: "you", mode: "preview", live: false });

// Versions of firmware of one model behave differently, so warn if they differ.
function describe(found) {
  const versions = {};
  for (const { model, firmware } of found) (versions[model] ??= new Set()).add(firmware);
  const mixed = Object.entries(versions).filter(([, all]) => all.size > 1).map(([model, all]) => ` ${model}: mixed firmware ${[...all].join(", ")}.`);
  return `${found.map(({ name, id, model, firmware }) => `${name === String(id) ? id : `${name} (${id})`} ${model} ${firmware}`).join(" · ")}.${mixed.join("")}`;
}

const act = (action, fields = {}) => shown && send("work_on_servo", { joint: servos.joint, action, ...fields });
const pressed = (button) => button.getAttribute("aria-pressed") === "true";
$("search").onclick = () => send("work_on_servo", { action: "search" });
$("torque").onclick = () => (pressed($("torque")) ? ask($("torque"), "The joint may fall. Switch torque off?", () => act("torque_off")) : act("torque_on"));
$("led").onclick = () => act(pressed($("led")) ? "led_off" : "led_on");
$("reboot").onclick = () => ask($("reboot"), "Torque will go off. Reboot the servo?", () => act("reboot"));
$("backup").onclick = () => act("backup");
$("restore").onchange = async ({ target }) => {
  const text = await target.files[0].text();
  target.value = "";
  act("restore", { text });
};
$("address").onsubmit = (event) => {
  event.preventDefault();
  const [id, rate] = [Number($("new-id").value), Number($("new-rate").value)];
  ask($("assign"), `Id ${id}, ${rate} baud. Sure?`, () => act("move", { address: [id, rate] }));
};
$("plot").onclick = () => {
  const left = [...$("servos-table").children].map((row) => row.dataset.register);
  act("plot", { names: left.length <= MOST_PLOTTED ? left : [] });
};

// Sliders of the gains; their values are only tried until they are saved.
const sliders = () => [...$("gains").querySelectorAll("input")];
const gains = () => Object.fromEntries(sliders().map(({ name, value }) => [name, Number(value)]));
function showGains({ joint, tunable, registers }) {
  const now = registers.filter(({ name }) => tunable.includes(name));
  $("tuning").hidden = !now.length;
  const state = JSON.stringify([joint, now.map(({ name, raw }) => [name, raw])]);
  if ($("gains").dataset.state === state) return; // keep the positions of moved sliders
  $("gains").dataset.state = state;
  $("gains").replaceChildren(...now.map(({ name, raw, range: [min, max] }) => {
    const value = createElement("output", {}, raw);
    const slider = createElement("input", { type: "range", name, min, max, "aria-label": name, oninput: () => setText(value, slider.value) });
    slider.value = raw;
    return createElement("label", { class: "gain" }, createElement("span", {}, name), slider, value);
  }));
  trialChart?.destroy();
  trialChart = null;
  $("trial-chart").replaceChildren();
}
function setGains(numbers) {
  for (const slider of sliders()) if (slider.name in numbers) [slider.value, slider.nextSibling.textContent] = [numbers[slider.name], numbers[slider.name]];
}
const tryGains = (action) => act(action, { gains: gains(), step_deg: Number($("step").value) });
for (const action of ["try", "suggest"]) $(action).onclick = () => ask($(action), "The joint will move. Sure?", () => tryGains(action));
$("stop").onclick = () => act("stop");
$("save").onclick = () => {
  const held = Object.fromEntries(shown.registers.map(({ name, raw }) => [name, raw]));
  for (const [name, value] of Object.entries(gains())) if (held[name] !== value) send("write_register", { joint: servos.joint, name, value: String(value) });
};

let drawing = Promise.resolve(); // the first drawing waits for its library, the next one for the first
async function draw(message) {
  if (!message.series) return charts.forEach((chart) => chart.append(message));
  const { default: Plot } = await import("./uplot.min.js");
  charts.forEach((chart) => chart.destroy());
  charts = message.series.map(({ quantity, joint }, column) => new PlotChart(Plot, quantity, [column], message, [joint]));
  $("plots-charts").replaceChildren(...charts.map((chart) => chart.element));
  charts.forEach((chart) => chart.fit($("plots-charts").clientWidth));
}
async function drawTrial(message) {
  const { default: Plot } = await import("./uplot.min.js");
  trialChart?.destroy();
  trialChart = new PlotChart(Plot, "step", [0, 1, 2], message, message.series.map(({ joint }) => joint));
  $("trial-chart").replaceChildren(trialChart.element);
  trialChart.fit($("trial-chart").clientWidth);
}
window.ikservo = { shown: () => shown, charts: () => charts, trial: () => trialChart }; // for tests
