// A second arm beside the arm of this page: its picture, and the lag of this arm while it follows.

import { ask } from "./confirm.js";
import { Connection } from "./connection.js";
import { Drawing } from "./drawing.js";
import { $, createElement, setText } from "./elements.js";
import { Picture } from "./picture.js";

const CLOSED = { lost: "No connection to the leader.", closed: "It was closed.", none: "It is not open.", "wrong-key": "Its key is wrong." };

export class Leader {
  constructor(key, send, onResize) {
    this.key = key;
    this.send = send; // sends messages to the arm of the page, which follows
    this.onResize = onResize;
    this.name = null;
    this.following = null; // the name of the leader while the arm follows
    this.drawing = new Drawing($("leader-drawing"), $("leader-backdrop"));
    this.picture = new Picture();
    $("follow").onclick = () => this.send("follow_arm", { leader: this.following ? null : this.name });
    $("leader-close").onclick = () => this.close();
    // An unsupported arm falls, so this takes a second press.
    $("leader-release").onclick = () => ask($("leader-release"), "The arm will fall. Sure?", () => this.connection.send("arm_action", { action: "release" }));
    $("leader-acknowledge").onclick = () => this.connection.send("acknowledge");
    new ResizeObserver(() => this.sendViewport()).observe($("leader-drawing"));
  }

  choose(name) {
    this.connection?.close();
    Object.assign(this, { name, status: null, view: null });
    setText($("leader-title"), `Leader: ${name}`);
    setText($("leader-state"), "connecting …");
    this.place(true);
    $("follow").focus();
    this.connection = new Connection(this.key, {
      arm_info: (message) => { this.view = message.views[0]; this.sendViewport(); },
      graph: (message) => this.picture.setGraph(message),
      things: (message) => this.picture.setThings([...message.things, ...message.links]),
      scene: (message) => this.draw(message),
      status: (message) => { this.status = message; this.update(); },
      refused: ({ message, hint }) => setText($("leader-state"), `${message} ${hint}`),
      closed: (why) => { this.status = null; this.update(); setText($("leader-state"), CLOSED[why]); },
    }, `live/${name}`);
  }

  close() {
    if (this.following) this.send("follow_arm", { leader: null });
    this.connection.close();
    this.name = null;
    this.place(false);
  }

  place(shown) {
    $("leader").hidden = !shown;
    document.querySelector(".stage").toggleAttribute("data-leader", shown);
    this.onResize();
  }

  draw(scene) {
    this.connection.confirmDrawn(scene.seq);
    const { backdrop, items } = this.picture.compose(scene);
    this.drawing.show(backdrop, items);
  }

  sendViewport() {
    if (!this.name || !this.view) return;
    this.drawing.fit();
    const { clientWidth: w, clientHeight: h } = $("leader-drawing");
    this.connection.send("viewport", { w, h, dpr: devicePixelRatio, view: this.view, webgl: false, handles: false });
  }

  showFollowing({ leader, lag = [] }) {
    this.following = leader;
    if (leader && leader !== this.name) this.choose(leader); // this page was loaded while the arm was following
    $("leader-lag").replaceChildren(...lag.flatMap(([name, value]) => [createElement("dt", {}, name), createElement("dd", {}, value)]));
    this.update();
  }

  // Called with every status of the arm of the page.
  show(status) {
    this.follower = status;
    this.update();
  }

  update() {
    if (!this.name) return;
    const { mode, controller } = this.follower ?? {};
    const limp = this.status?.health.joints.some((joint) => joint.torque !== "on");
    const stopped = this.status?.mode === "stopped";
    const ready = mode === "preview" && limp && this.status?.mode === "preview";
    setText($("follow"), this.following ? "End following" : "Follow");
    $("follow").disabled = controller !== "you" || !(this.following || ready);
    $("leader-release").hidden = Boolean(limp || stopped);
    $("leader-release").disabled = this.status?.mode !== "preview" || this.status?.controller !== "you";
    $("leader-acknowledge").hidden = !stopped;
    if (this.status) setText($("leader-state"), this.describe(limp, mode));
  }

  describe(limp, mode) {
    const { banner } = this.status;
    if (this.status.mode === "stopped") return `${banner.message} ${banner.hint}`;
    if (this.following) return "Guide the leader by hand; the other arm follows.";
    if (this.status.mode !== "preview") return this.status.activity || "It is in use.";
    if (!limp) return "The leader's torque is on, so it cannot be guided by hand. Support the leader, then release it.";
    return mode === "live" ? "Switch Live off, then follow." : "The leader is limp and ready to lead.";
  }
}
