// The socket: proves the key, counts messages, and tells the server that the page lives.

import { hmac } from "./sha256.js";

const BEAT_MS = 100; // the server holds the arm after 300 ms of silence
const AGAIN_MS = 1000;

export class Connection {
  constructor(key, listeners) {
    this.key = key;
    this.listeners = listeners;
    this.seq = 0;
    this.seen = 0;
    this.open = false;
    setInterval(() => this.beat(), BEAT_MS);
    document.addEventListener("visibilitychange", () => this.beat());
    this.connect();
  }

  connect() {
    const address = new URL("live", document.baseURI);
    address.protocol = address.protocol.replace("http", "ws");
    address.hash = "";
    this.socket = new WebSocket(address);
    this.socket.onmessage = (event) => this.hear(JSON.parse(event.data));
    this.socket.onclose = (event) => this.lost(event);
  }

  hear(message) {
    if (message.kind === "challenge") {
      this.seq = this.seen = 0;
      this.socket.send(JSON.stringify({ kind: "hello", proof: hmac(this.key, message.nonce) }));
      return;
    }
    if (!this.open) {
      this.open = true;
      this.listeners.opened?.();
    }
    this.listeners[message.kind]?.(message);
  }

  drawn(scene) {
    this.seen = scene;
    this.beat();
  }

  beat() {
    this.say("beat", { visible: document.visibilityState === "visible" });
  }

  say(kind, fields = {}) {
    if (!this.open || this.socket.readyState !== WebSocket.OPEN) return;
    this.seq += 1;
    this.socket.send(JSON.stringify({ kind, seq: this.seq, seen: this.seen, ...fields }));
  }

  lost(event) {
    this.open = false;
    this.listeners.lost?.(event.code === 4401 ? "key" : "gone", event.reason);
    if (event.code !== 4401) setTimeout(() => this.connect(), AGAIN_MS);
  }
}
