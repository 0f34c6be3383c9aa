// Actions on the target and the whole arm: go there, undo, redo, relax, hold, release; fit the view; help.

import { ask } from "./confirm.js";
import { $, place } from "./elements.js";

const ONE_COLUMN = matchMedia("(max-width: 1020px)"); // the same width as in style.css

export class Actions {
  constructor(send) {
    this.send = send;
    this.status = this.at = null;
    this.path = null; // the number of the drawn path
    this.limp = []; // the joints without torque
    $("execute").onclick = () => send("arm_action", { action: "execute", path: this.path.number });
    $("undo").onclick = () => send("undo", { redo: false });
    $("redo").onclick = () => send("undo", { redo: true });
    $("relax").onclick = () => send("arm_action", { action: "relax" });
    $("hold").onclick = () => this.limp.forEach((joint) => send("set_torque", { joint, on: true }));
    // An unsupported arm falls, so this takes a second press.
    $("release").onclick = () => ask($("release"), "The arm will fall. Sure?", () => this.send("arm_action", { action: "release" }));
    $("fit").onclick = () => send("fit_view");
    $("help-button").onclick = () => this.toggleHelp();
    $("help-close").onclick = () => this.toggleHelp();
    addEventListener("keydown", (event) => this.onKey(event));
    ONE_COLUMN.addEventListener("change", () => this.placeExecute());
    this.placeExecute();
  }

  // In one column, the drawing is out of sight while goals are typed, so the button moves to the
  // bar.
  placeExecute() {
    if (ONE_COLUMN.matches) $("live").before($("execute"));
    else $("redo").after($("execute"));
    this.follow(this.path, null);
  }

  // Show the button beside the target (a pixel of the drawing) while the path is drawn and can be carried out.
  follow(path, at) {
    const button = $("execute");
    Object.assign(this, { path, at });
    button.disabled = !path || path.number !== this.status?.path || !isIdle(this.status);
    const shown = at !== null && !button.disabled && !ONE_COLUMN.matches;
    button.classList.toggle("at-target", shown);
    if (!shown) return button.style.removeProperty("transform");
    const box = $("drawing").getBoundingClientRect();
    const [x, y] = place(at, button, box);
    button.style.transform = `translate(${box.left + x}px, ${box.top + y}px)`;
  }

  toggleHelp() {
    const help = $("help");
    if (help.open) {
      help.close();
      $("help-button").focus();
    } else {
      this.onOpen();
      help.show(); // not modal, so that Stop can still be pressed
      $("help-close").focus();
    }
    $("help-button").setAttribute("aria-expanded", help.open);
  }

  dismiss() {
    if ($("help").open) this.toggleHelp();
  }

  onKey(event) {
    if (event.target.closest?.("input, select")) return;
    const key = event.key.toLowerCase();
    if ((event.ctrlKey || event.metaKey) && !event.altKey && (key === "z" || key === "y")) {
      event.preventDefault();
      const button = $(key === "y" || event.shiftKey ? "redo" : "undo");
      if (!button.disabled) button.click();
    } else if (event.ctrlKey || event.metaKey || event.altKey) return;
    else if (key === "?") this.toggleHelp();
    else if (key === "f") this.send("fit_view");
  }

  show(status) {
    const free = status.controller === "you" && ["preview", "live"].includes(status.mode);
    this.status = status;
    $("undo").disabled = !free || !status.undo;
    $("redo").disabled = !free || !status.redo;
    const { joints } = status.health;
    this.limp = joints.filter(({ torque }) => torque !== "on").map(({ name }) => name);
    $("hold").hidden = this.limp.length === 0;
    $("relax").hidden = this.limp.length > 0 && this.limp.length === joints.length;
    for (const id of ["relax", "hold", "release"]) $(id).disabled = !isIdle(status);
    this.follow(this.path, this.at);
  }
}

export const isIdle = ({ controller, mode }) => controller === "you" && mode === "preview";
