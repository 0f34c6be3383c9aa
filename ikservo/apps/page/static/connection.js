// The websocket: proves the key, numbers messages and sends heartbeats.

import { hmac } from "./sha256.js";

const HEARTBEAT_PERIOD_MS = 100; // in Live the server holds the arm after 300 ms of silence
const RECONNECT_DELAY_MS = 1000;
const FULL = 1013; // the server has no room for another page
const FINAL = { 4401: "wrong-key", 4404: "none", 4410: "closed" }; // the server's close codes
const KEPT = new Set(["scene", "status"]);

export class Connection {
  // The path belongs to the arm, or to a page that moves nothing and needs no heartbeats.
  constructor(key, handlers, path = "live") {
    this.key = key;
    this.handlers = handlers;
    this.path = path;
    this.seq = 0;
    this.seen = 0; // the last scene that was drawn
    this.confirmed = 0; // the scene that the last message confirmed
    this.open = false;
    const beat = () => this.sendHeartbeat();
    if (path.startsWith("live")) this.timer = setInterval(beat, HEARTBEAT_PERIOD_MS);
    if (path.startsWith("live")) document.addEventListener("visibilitychange", beat);
    this.connect();
  }

  connect() {
    const address = new URL(this.path, document.baseURI);
    address.protocol = address.protocol.replace("http", "ws");
    address.hash = "";
    this.socket = new WebSocket(address);
    this.socket.onmessage = (event) => this.receive(JSON.parse(event.data));
    this.socket.onclose = (event) => this.onClose(event);
  }

  receive(message) {
    if (message.kind === "challenge") {
      this.seq = this.seen = this.confirmed = 0;
      this.kept = {};
      this.socket.send(JSON.stringify({ kind: "hello", proof: hmac(this.key, message.nonce) }));
      return;
    }
    this.open = true;
    this.handlers.heard?.();
    this.handlers[message.kind]?.(KEPT.has(message.kind) ? this.complete(message) : message);
  }

  // The server sends only changed fields of these; the other fields stay the same objects.
  complete(message) {
    return (this.kept[message.kind] = { ...this.kept[message.kind], ...message });
  }

  // Any message in the same frame also confirms it.
  confirmDrawn(seq) {
    this.seen = seq;
    if (this.confirmed !== seq) this.sendHeartbeat();
  }

  sendHeartbeat() {
    this.send("heartbeat", { visible: document.visibilityState === "visible" });
  }

  send(kind, fields = {}) {
    if (!this.open || this.socket.readyState !== WebSocket.OPEN) return;
    this.seq += 1;
    this.confirmed = this.seen;
    this.socket.send(JSON.stringify({ kind, seq: this.seq, seen: this.seen, ...fields }));
  }

  // Ends the connection for good.
  close() {
    clearInterval(this.timer);
    this.ended = true;
    this.socket.close();
  }

  onClose(event) {
    this.open = false;
    if (this.ended) return;
    const final = FINAL[event.code];
    this.handlers.closed?.(final ?? (event.code === FULL ? "full" : "lost"), event.reason);
    if (!final) setTimeout(() => this.ended || this.connect(), RECONNECT_DELAY_MS);
  }
}
