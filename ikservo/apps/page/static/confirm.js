// A button that asks for confirmation: it needs a second press.

import { setText } from "./elements.js";

const ASK_MS = 4000;

export function ask(button, question, act) {
  const asked = Boolean(button.dataset.asked);
  if (asked) forget(button);
  if (asked) return act();
  button.dataset.label = button.textContent;
  setText(button, question);
  button.dataset.asked = setTimeout(() => forget(button), ASK_MS);
}

// Reset the button as if it had not been pressed.
function forget(button) {
  clearTimeout(Number(button.dataset.asked));
  delete button.dataset.asked;
  setText(button, button.dataset.label);
}
