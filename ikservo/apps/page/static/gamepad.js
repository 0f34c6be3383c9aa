// The browser's gamepads: the sticks move the target while they are deflected.

const DEAD_ZONE = 0.12;
const POLL_PERIOD_MS = 50;

const applyDeadZone = (value) => (Math.abs(value) < DEAD_ZONE ? 0 : value);

export class Gamepads {
  constructor(send, showStatus) {
    this.send = send;
    this.wasActive = false;
    this.buttonGrip = 0; // the page's own buttons: 1 closes the gripper, -1 opens it
    this.handGrip = 0; // the same for a controller of a headset, in each of its frames
    this.polledAt = 0;
    addEventListener("gamepadconnected", (event) => showStatus(`${event.gamepad.id.slice(0, 40)}: sticks move the tip, triggers the gripper`));
    addEventListener("gamepaddisconnected", () => showStatus(""));
  }

  // The gripper moves as long as the button is held down, by a pointer or by Enter.
  bindButton(button, grip) {
    const press = () => {
      this.buttonGrip = grip;
      this.poll(performance.now(), true); // a click may be shorter than the poll period
    };
    const release = () => { this.buttonGrip = 0; };
    button.addEventListener("pointerdown", press);
    button.addEventListener("keydown", (event) => event.key === "Enter" && press());
    for (const end of ["pointerup", "pointercancel", "pointerleave", "keyup", "blur"]) button.addEventListener(end, release);
    button.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  poll(now, atOnce = false) {
    if (!atOnce && now - this.polledAt < POLL_PERIOD_MS) return;
    this.polledAt = now;
    const pad = [...navigator.getGamepads()].find((found) => found?.connected);
    const axes = [0, 1, 2, 3].map((i) => applyDeadZone(pad?.axes[i] ?? 0));
    const grip = applyDeadZone(this.buttonGrip || this.handGrip || (pad?.buttons[7]?.value ?? 0) - (pad?.buttons[6]?.value ?? 0));
    const active = axes.some(Boolean) || grip !== 0;
    if (active || this.wasActive) {
      this.send("gamepad", { axes: [axes[0], -axes[1], axes[2], -axes[3]], grip });
    }
    this.wasActive = active;
    if (pad?.buttons[1]?.pressed) this.send("stop", { by: "gamepad" });
  }
}
