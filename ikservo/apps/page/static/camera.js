// The camera's picture beside the drawing, instead of it, or as a view; problems are shown below.

import { $, setText, updateChoices } from "./elements.js";

const PLACES = { off: "No camera", beside: "Beside", large: "Large" };
const RETRY_MS = 2000;

export class CameraPicture {
  // askAddress() requests the address of the pictures; choose(name) shows another camera of the arm.
  constructor(askAddress, chooseCamera) {
    this.askAddress = askAddress;
    this.chooseCamera = chooseCamera;
    this.place = "beside";
    this.isView = false; // whether the arm is drawn over the whole picture, as the camera sees it
    this.camera = null;
    this.pictureTrouble = null; // why the view takes no targets
    this.asked = false; // whether the address of the pictures was requested
    $("camera-picture").onerror = () => this.retry();
  }

  // Called with every list of arms, with the camera of the shown arm if it has one.
  show(camera) {
    if (camera?.chosen !== this.camera?.chosen) this.drop(); // the picture is from another camera
    this.camera = camera;
    const { choices = [], chosen } = camera ?? {};
    $("camera-names").hidden = choices.length < 2;
    updateChoices($("camera-names"), choices, chosen, this.chooseCamera);
    const place = this.isView ? "view" : this.place;
    $("camera-places").hidden = !camera || this.isView;
    $("camera").hidden = !camera || place === "off";
    if (!camera) return;
    updateChoices($("camera-places"), Object.keys(PLACES), this.place, (place) => this.choose(place, camera), (place) => PLACES[place]);
    document.body.dataset.camera = place;
    $("camera-picture").alt = `Picture of ${camera.name}`;
    const trouble = camera.trouble || this.pictureTrouble;
    setText($("camera-note"), trouble || (camera.calibrated ? camera.name : `${camera.name} – not calibrated`));
    if (trouble) $("camera").dataset.trouble = camera.late ? "late" : "error";
    else delete $("camera").dataset.trouble;
    if (place !== "off" && !this.asked) this.ask();
  }

  setView(isView) {
    if (this.isView === isView) return;
    this.isView = isView;
    if (!isView && this.place === "off") this.drop();
    this.show(this.camera);
  }

  showPictureTrouble(trouble) {
    if (this.pictureTrouble === trouble) return;
    this.pictureTrouble = trouble;
    this.show(this.camera);
  }

  choose(place, camera) {
    this.place = place;
    if (place === "off") this.drop();
    this.show(camera);
  }

  ask() {
    this.asked = true;
    this.askAddress();
  }

  setAddress(url) {
    if (this.place !== "off" || this.isView) $("camera-picture").src = url;
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
