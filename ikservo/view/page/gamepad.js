// The browser's gamepads: the sticks move the target while they are held over.

const DEAD = 0.12;
const EVERY_MS = 50;

const rest = (value) => (Math.abs(value) < DEAD ? 0 : value);

export class Gamepads {
  constructor(say, tell) {
    this.say = say;
    this.tell = tell;
    this.moved = false;
    this.pressed = 0; // the page's own buttons: 1 closes the gripper, -1 opens it
    this.last = 0;
    addEventListener("gamepadconnected", (event) => tell(`${event.gamepad.id.slice(0, 40)}: sticks move the tip, triggers the gripper`));
    addEventListener("gamepaddisconnected", () => tell(""));
  }

  // A button that grips for as long as it is held down, by a pointer or by Enter.
  hold(button, grip) {
    const press = () => { this.pressed = grip; };
    const lift = () => { this.pressed = 0; };
    button.addEventListener("pointerdown", press);
    button.addEventListener("keydown", (event) => event.key === "Enter" && press());
    for (const end of ["pointerup", "pointercancel", "pointerleave", "keyup", "blur"]) button.addEventListener(end, lift);
    button.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  poll(now) {
    if (now - this.last < EVERY_MS) return;
    this.last = now;
    const pad = [...navigator.getGamepads()].find((found) => found?.connected);
    const axes = [0, 1, 2, 3].map((i) => rest(pad?.axes[i] ?? 0));
    const grip = rest(this.pressed || (pad?.buttons[7]?.value ?? 0) - (pad?.buttons[6]?.value ?? 0));
    const active = axes.some(Boolean) || grip !== 0;
    if (active || this.moved) {
      this.say("gamepad", { axes: [axes[0], -axes[1], axes[2], -axes[3]], grip });
    }
    this.moved = active;
    if (pad?.buttons[1]?.pressed) this.say("stop");
  }
}
