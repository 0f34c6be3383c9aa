// Small ways of making elements; text is always text, never markup.

export const $ = (id) => document.getElementById(id);

export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== null && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

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
    setAttribute(button, "aria-checked", on);
    button.tabIndex = on || (!names.includes(chosen) && button === group.firstChild) ? 0 : -1;
  }
}

export function setText(element, words) {
  if (element.textContent !== words) element.textContent = words;
}

export function setAttribute(element, name, value) {
  if (element.getAttribute(name) !== String(value)) element.setAttribute(name, value);
}

// As many children as there are rows, made where they are missing; `fill` puts in what is new.
export function rows(list, entries, begin, fill) {
  const made = (list.made ??= []);
  while (made.length > entries.length) made.pop().element.remove();
  while (made.length < entries.length) {
    made.push(begin());
    list.append(made.at(-1).element);
  }
  entries.forEach((entry, i) => fill(made[i], entry));
}
