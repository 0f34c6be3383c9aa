// An immersive WebXR session: the pose of a held controller, or of the phone itself.

import { heading, multiply } from "./quaternions.js";

const FROM_XR = [0.5, 0.5, -0.5, -0.5]; // from WebXR's axes (y upwards, -z ahead) to x ahead, z upwards
const SQUEEZE = 1;
const TRIGGER = 0; // also the pinch of a bare hand
const STICK = 3;
const LOWER_BUTTON = 4;
const UPPER_BUTTON = 5;

export class HandSession {
  // handlers: press() numbers a press; frame(now, source) in every frame; lost() when the hand must let go; ended().
  static async start(handlers) {
    const session = await navigator.xr.requestSession("immersive-ar", { optionalFeatures: ["dom-overlay", "local-floor", "hand-tracking"], domOverlay: { root: document.body } });
    try {
      const gl = document.createElement("canvas").getContext("webgl", { xrCompatible: true });
      await session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl) });
      return new HandSession(session, gl, await session.requestReferenceSpace("local"), handlers);
    } catch (error) {
      session.end().catch(() => {});
      throw error;
    }
  }

  constructor(session, gl, space, handlers) {
    Object.assign(this, { session, gl, space, handlers });
    this.handed = null; // the controller that was squeezed last
    this.presses = new Map(); // by controller: the number of its squeeze, 0 while it is open
    session.addEventListener("visibilitychange", () => session.visibilityState !== "visible" && handlers.lost());
    space.addEventListener("reset", () => handlers.lost());
    session.addEventListener("end", () => {
      document.body.removeAttribute("data-xr");
      handlers.ended();
    });
    document.body.toggleAttribute("data-xr", true);
    session.requestAnimationFrame((now, frame) => this.onFrame(now, frame));
  }

  end() {
    this.session.end().catch(() => {}); // it may have ended already
  }

  onFrame(now, frame) {
    const { session, gl, space } = this;
    session.requestAnimationFrame((next, nextFrame) => this.onFrame(next, nextFrame));
    gl.bindFramebuffer(gl.FRAMEBUFFER, session.renderState.baseLayer.framebuffer);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT); // nothing is drawn over the real arm
    const isShown = session.visibilityState === "visible";
    const viewer = readPose(frame.getViewerPose(space));
    const forward = viewer && heading(viewer.rotation);
    const sources = [...session.inputSources].filter((source) => source.gripSpace && source.gamepad);
    const hands = sources.filter((source) => source.hand);
    // Of two bare hands, the right one moves the tool while the left one pinches.
    const controllers = hands.length ? hands.filter(({ handedness }) => handedness === "right") : sources;
    const left = hands.find(({ handedness }) => handedness === "left");
    const isDown = (source, button) => Boolean(source?.gamepad.buttons[button]?.pressed);
    const squeezed = (source) => hands.length ? isDown(left, TRIGGER) : isDown(source, SQUEEZE);
    // A controller that is squeezed when it appears must be let go first: -1.
    const press = (source) => squeezed(source) ? (this.presses.get(source) ?? -1) || this.handlers.press() : 0;
    this.presses = new Map(controllers.map((source) => [source, press(source)]));
    this.handed = controllers.find((source) => source === this.handed && squeezed(source)) ?? controllers.find(squeezed) ?? controllers.find((source) => source === this.handed) ?? null;
    if (!controllers.length) return this.handlers.frame(now, { pose: isShown ? viewer : null, heading: forward });
    const source = this.handed ?? controllers[0];
    const pose = isShown ? readPose(frame.getPose(source.gripSpace, space)) : null;
    const pressed = (button, { gamepad } = source) => Number(gamepad.buttons[button]?.value ?? 0);
    const pinch = squeezed(source) ? Math.sign(pressed(TRIGGER) - 0.5) : 0; // the gripper follows the right hand
    this.handlers.frame(now, {
      pose,
      press: this.presses.get(source),
      heading: forward,
      grip: hands.length ? pinch : pressed(TRIGGER) - pressed(LOWER_BUTTON),
      records: pressed(STICK) > 0,
      stops: controllers.some((each) => pressed(UPPER_BUTTON, each) > 0),
      pulse: (ms) => source.gamepad.hapticActuators?.[0]?.pulse(0.6, ms),
    });
  }
}

// Position and rotation with z upwards; null while tracking is lost, or the position is only guessed.
function readPose(pose) {
  if (!pose || pose.emulatedPosition) return null;
  const { position: p, orientation: o } = pose.transform;
  return { position: [-p.z, -p.x, p.y], rotation: multiply(FROM_XR, [o.w, o.x, o.y, o.z]) };
}
