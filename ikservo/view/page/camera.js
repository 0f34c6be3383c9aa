// The camera's picture beside the arm or behind it; what is wrong with it is said below it.

import { $, setText, updateChoices } from "./elements.js";

const PLACES = { off: "No camera", beside: "Beside", behind: "Behind" };
const RETRY_MS = 2000;

export class CameraPicture {
  constructor(send) {
    this.send = send;
    this.place = "beside";
    this.asked = false; // whether the address of the pictures was asked for
    $("camera-picture").onerror = () => this.retry();
  }

  // Called with every list of arms, of which the camera is a part.
  show(camera) {
    $("camera-places").hidden = !camera;
    $("camera").hidden = !camera || this.place === "off";
    if (!camera) return;
    updateChoices($("camera-places"), Object.keys(PLACES), this.place, (place) => this.choose(place, camera), (place) => PLACES[place]);
    document.body.dataset.camera = this.place;
    $("camera-picture").alt = `Picture of ${camera.name}`;
    setText($("camera-note"), camera.trouble || camera.name);
    $("camera").toggleAttribute("data-trouble", Boolean(camera.trouble));
    if (this.place !== "off" && !this.asked) this.ask();
  }

  choose(place, camera) {
    this.place = place;
    if (place === "off") this.drop();
    this.show(camera);
  }

  ask() {
    this.asked = true;
    this.send("show_camera");
  }

  setAddress(url) {
    if (this.place !== "off") $("camera-picture").src = url;
  }

  // Without an address nothing is fetched, and the server closes the camera.
  drop() {
    this.asked = false;
    $("camera-picture").removeAttribute("src");
  }

  retry() {
    if (!$("camera-picture").hasAttribute("src")) return;
    $("camera-picture").removeAttribute("src");
    setTimeout(() => { this.asked = false; }, RETRY_MS);
  }
}
