// Helpers that create and update elements; text is always text, never markup.

export const $ = (id) => document.getElementById(id);

export function createElement(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== null && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

// A group of radio buttons; arrow keys move the focus and wrap around.
export function updateChoices(group, names, chosen, choose, label = (name) => name) {
  const same = [...group.children].map((button) => button.value).join() === names.join();
  if (!same) {
    group.replaceChildren(...names.map((name) => createElement("button", { type: "button", role: "radio", value: name, onclick: () => choose(name) }, label(name))));
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

// Returns a place for an element beside a pixel: inside the drawing, and below the texts in its corner.
export function place([x, y], element, { left, top, width, height }) {
  const inside = (at, size, length) => Math.max(8, Math.min(at, size - length - 8));
  const [right, down] = [inside(x + 18, width, element.offsetWidth), inside(y + 14, height, element.offsetHeight)];
  const corner = document.querySelector(".corner").getBoundingClientRect();
  const covers = right + left < corner.right && down + top < corner.bottom;
  return [right, covers ? corner.bottom - top + 8 : down];
}

export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function setAttribute(element, name, value) {
  if (element.getAttribute(name) !== String(value)) element.setAttribute(name, value);
}

// Keeps one row element per entry: creates missing ones, removes surplus ones, then updates all.
export function updateRows(list, entries, create, update) {
  const rows = (list.rows ??= []);
  while (rows.length > entries.length) rows.pop().element.remove();
  while (rows.length < entries.length) {
    rows.push(create());
    list.append(rows.at(-1).element);
  }
  entries.forEach((entry, i) => update(rows[i], entry));
}
