// The browser's gamepads: the sticks move the target while they are held over.

const DEAD = 0.12;
const EVERY_MS = 50;

const rest = (value) => (Math.abs(value) < DEAD ? 0 : value);

export class Gamepads {
  constructor(say, tell) {
    this.say = say;
    this.tell = tell;
    this.moved = false;
    this.last = 0;
    addEventListener("gamepadconnected", (event) => tell(`${event.gamepad.id.slice(0, 40)}: sticks move the tip`));
    addEventListener("gamepaddisconnected", () => tell(""));
  }

  poll(now) {
    if (now - this.last < EVERY_MS) return;
    this.last = now;
    const pad = [...navigator.getGamepads()].find((found) => found?.connected);
    if (!pad) return;
    const axes = [0, 1, 2, 3].map((i) => rest(pad.axes[i] ?? 0));
    const grip = (pad.buttons[7]?.value ?? 0) - (pad.buttons[6]?.value ?? 0);
    const active = axes.some(Boolean) || Math.abs(grip) > DEAD;
    if (active || this.moved) {
      this.say("gamepad", { axes: [axes[0], -axes[1], axes[2], -axes[3]], grip: rest(grip) });
    }
    this.moved = active;
    if (pad.buttons[1]?.pressed) this.say("stop");
  }
}
