// Small ways of making elements; text is always text, never markup.

export const $ = (id) => document.getElementById(id);

export function make(tag, attributes = {}, ...children) {
  const namespace = SVG.has(tag) ? "http://www.w3.org/2000/svg" : "http://www.w3.org/1999/xhtml";
  const element = document.createElementNS(namespace, tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== null && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

const SVG = new Set(["svg", "line", "circle", "path", "text"]);

// A group of buttons of which one is chosen; arrow keys go round, as people expect of radio buttons.
export function choices(group, names, chosen, choose, words = (name) => name) {
  const same = [...group.children].map((button) => button.value).join() === names.join();
  if (!same) {
    group.replaceChildren(...names.map((name) => make("button", { type: "button", role: "radio", value: name, onclick: () => choose(name) }, words(name))));
    group.onkeydown = (event) => {
      const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      const at = [...group.children].indexOf(document.activeElement);
      if (!step || at < 0) return;
      event.preventDefault();
      const next = group.children[(at + step + names.length) % names.length];
      next.focus();
      next.click();
    };
  }
  for (const button of group.children) {
    const on = button.value === chosen;
    button.setAttribute("aria-checked", on);
    button.tabIndex = on || (!names.includes(chosen) && button === group.firstChild) ? 0 : -1;
  }
}

export function setText(element, words) {
  if (element.textContent !== words) element.textContent = words;
}

// A range with a needle; all positions are shares of the width.
export function range({ value, goal = null, state = "", swept = null, label, low, high }) {
  const x = (share) => `${(100 * Math.min(1, Math.max(0, share))).toFixed(2)}%`;
  const bar = (kind, from, to) => make("line", { class: kind, x1: x(from), x2: x(to), y1: "50%", y2: "50%" });
  return make("div", { class: "range", role: "meter", "aria-label": label, "aria-valuemin": low, "aria-valuemax": high, "aria-valuenow": value.toFixed(3) },
    make("svg", { "aria-hidden": "true" },
      bar("track", 0, 1),
      swept ? bar("swept", ...swept) : null,
      goal === null ? null : make("circle", { class: "goal", cx: x(goal), cy: "50%", r: 5 }),
      make("circle", { class: `needle ${state}`, cx: x(value), cy: "50%", r: 6 })));
}
