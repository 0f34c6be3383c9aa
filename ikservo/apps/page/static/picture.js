// Items of a scene in pixels, in painting order, for drawing.js. The server sends the arm
// once and then positions of joints, see ikservo/apps/page/drawing/scene_graph.py. Kinds of items:
//   { kind: "polygon",  style, rings: [[[x, y], …], …] }   filled together by the non-zero rule
//   { kind: "polyline", style, points: [[x, y], …] }
//   { kind: "circle" or "cross", style, at: [x, y], r }
//   { kind: "text",     style, at, text }                  `at` is its lower left corner
// Items of a link have `link`, those of a joint `joint`, things `name`.

import { Dials } from "./dials.js";
import { origin } from "./geometry.js";
import { placeLinks } from "./kinematics.js";
import { markItems, traceItems } from "./marks.js";
import { outlineLinks } from "./outlines.js";
import { Projection } from "./projection.js";
import { backdropItems, scaleItems, thingItem } from "./surroundings.js";
import { TipPaths } from "./tip_paths.js";

// Whether nothing has changed: unchanged fields are the same objects in the next scene.
export const isSame = (scene, shown) => Object.keys(scene).every((name) => name === "seq" || scene[name] === shown[name]);

export class Picture {
  things = [];

  // The things around the arm, see ikservo/apps/page/panels/things_panel.py.
  setThings(things) {
    this.things = things.filter(({ drawn }) => drawn);
    this.shown = {};
  }

  setGraph(graph) {
    this.graph = graph;
    this.dials = new Dials(graph);
    this.paths = new TipPaths((positions) => origin(placeLinks(graph, positions).get(graph.tip).pose));
    this.shown = {}; // the scene of the last picture
    this.last = null;
  }

  // Returns `items`, `backdrop` (null in 3D), and the pixel `goalAt` of the target or else of the goal's tip.
  // Unchanged parts are the same objects as before.
  compose(scene) {
    if (isSame(scene, this.shown)) return this.last;
    const projection = new Projection(scene.camera);
    const arm = placeLinks(this.graph, scene.measured);
    const goal = scene.goal && placeLinks(this.graph, scene.goal);
    const tip = (placed) => origin(placed.get(this.graph.tip).pose);
    this.paths.update(scene, performance.now());
    const marks = [...this.paths.items(projection, scene.webgl), ...markItems(scene, tip(arm), projection)];
    const trace = traceItems(scene, projection);
    const items = scene.webgl ? [...marks, ...trace] : [...this.armItems(scene, arm, goal, projection), ...marks, ...scaleItems(projection), ...trace];
    const backdrop = scene.webgl ? null : this.composeBackdrop(scene, projection);
    this.shown = scene;
    this.last = { items, backdrop, goalAt: projection.project(scene.marker?.target ?? tip(goal ?? arm)) };
    return this.last;
  }

  // Items that change only with camera, region and planned path, whose postures are behind the arm.
  composeBackdrop(scene, projection) {
    const same = ["camera", "region", "region_pose", "swept"].every((name) => scene[name] === this.shown[name]);
    if (same && this.last.backdrop) return this.last.backdrop;
    const swept = (scene.swept ?? []).flatMap((positions) => outlineLinks(this.graph, placeLinks(this.graph, positions), projection));
    return [...backdropItems(this.graph, this.things, scene, projection), ...swept.map(({ link, rings }) => ({ kind: "polygon", style: "swept", rings, link }))];
  }

  armItems(scene, arm, goal, projection) {
    const marked = [scene.picked, ...(scene.refused_pair ?? [])];
    const ghost = goal ? outlineLinks(this.graph, goal, projection) : [];
    const links = outlineLinks(this.graph, arm, projection);
    const behind = links.filter(({ link }) => scene.behind && link === scene.hover);
    return [
      ...this.things.filter(({ name }) => marked.includes(name)).map((thing) => thingItem(scene.refused_pair?.includes(thing.name) ? "touching" : "picked", thing, projection)),
      ...ghost.map(({ link, rings }) => ({ kind: "polygon", style: goalStyle(link, scene), rings, link })),
      ...links.map(({ link, rings }) => ({ kind: "polygon", style: armStyle(link, scene, projection), rings, link })),
      ...behind.map(({ rings }) => ({ kind: "polygon", style: "behind", rings })),
      ...this.dials.items(arm, goal, projection, scene.limp),
    ];
  }
}

// Over the picture of a calibrated camera, which shows the arm itself, only outlines are drawn.
function armStyle(link, { hover, grabbed }, { lens }) {
  if (link === grabbed) return lens ? "outline_grabbed" : "grabbed";
  if (link === hover) return lens ? "outline_hover" : "hover";
  return lens ? "outline" : "measured";
}

function goalStyle(link, { refused_pair }) {
  if (refused_pair === null) return "ghost";
  return refused_pair.includes(link) ? "touching" : "refused";
}
