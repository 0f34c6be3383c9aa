// The 3D scene with three.js: a graph of links, moved by the positions of the joints. World
// coordinates are the arm's base frame in metres, z upwards; the camera is the server's.

import * as THREE from "./three.min.js";
import { Handles } from "./handles3d.js";
import { Markings } from "./markings3d.js";
import { SoftwareRenderer } from "./software_renderer.js";

const NEAR_M = 0.01;
const LONGEST_FRAME_MS = 3000; // longest time to wait for a frame
const SHADOW_PX = 1024;
const MAX_PIXEL_RATIO = 2;
const TRIAD_M = { base: 0.06, tool: 0.035 };
const MAX_SWEPT = 5; // number of postures that are drawn along a path
const AXES = [[0xd6453d, [1, 0, 0]], [0x3d9a50, [0, 1, 0]], [0x3d6fd6, [0, 0, 1]]];
const HIGHLIGHT = 0.75; // fraction of the highlight colour for the link under the pointer
const BEHIND_OPACITY = 0.3; // opacity of links in front of a link that was selected behind them

// Throws if WebGL fails.
export function createRenderer(canvas, hasCard) {
  if (!hasCard) return new SoftwareRenderer(canvas);
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = THREE.PCFShadowMap;
  return renderer;
}

export class Scene3D {
  // Takes the arm and the shapes of its links, see ikservo/apps/page/drawing/scene_graph.py.
  constructor(renderer, graph, shapes) {
    this.renderer = renderer;
    this.camera = new THREE.PerspectiveCamera();
    this.camera.matrixAutoUpdate = false;
    this.scene = new THREE.Scene();
    this.graph = graph;
    this.size = { width: 0, height: 0, ratio: 0 };
    this.arm = new LinkTree(graph, shapes, () => new THREE.MeshStandardMaterial({ roughness: 0.55, metalness: 0.05 }));
    this.ghostMaterials = createGhostMaterials();
    this.ghost = new LinkTree(graph, shapes, () => this.ghostMaterials.ghost);
    this.sweep = new Sweep(this.ghost, this.ghostMaterials.swept);
    this.path = this.swept = null; // the shown path and postures
    this.arm.root.traverse((part) => { part.castShadow = part.receiveShadow = true; });
    this.arm.tip.add(createTriad(TRIAD_M.tool));
    this.markings = new Markings(graph);
    this.handles = new Handles(this.camera, graph.handles);
    const lights = createLights(graph);
    this.sun = lights[1];
    this.scene.add(this.handles.root, this.arm.root, this.ghost.root, this.sweep.root, this.markings.root, createTriad(TRIAD_M.base), ...lights);
    this.setColours();
  }

  // The colours of the page's style, which depend on the theme; those of the URDF stay.
  setColours() {
    const style = getComputedStyle(document.documentElement);
    const read = (name) => readColour(style, name);
    this.hoverColour = read("--draw-link-hover");
    this.arm.setDefaultColour(read("--draw-link"));
    this.ghostMaterials.ghost.color.copy(read("--draw-ghost-edge"));
    this.ghostMaterials.swept.color.copy(read("--draw-ghost-edge"));
    this.ghostMaterials.refused.color.copy(read("--draw-bad"));
    this.ghostMaterials.touching.color.copy(read("--draw-bad"));
    this.markings.setColours(read);
  }

  // Returns whether the size has changed.
  fit(width, height, ratio) {
    if (this.size.width === width && this.size.height === height && this.size.ratio === ratio) return false;
    this.size = { width, height, ratio };
    this.renderer.setPixelRatio(Math.min(ratio, MAX_PIXEL_RATIO));
    this.renderer.setSize(width, height, false);
    return true;
  }

  setShadows(on) {
    this.sun.castShadow = on;
  }

  // Shows a scene of the server, see ikservo/apps/page/drawing/scene_graph.py.
  update(scene) {
    this.setCamera(scene.camera);
    this.arm.setJoints(scene.measured);
    this.showPlanned(scene);
    this.showGoal(scene);
    this.handles.show((scene.goal === null ? this.arm : this.ghost).tipPosition(), scene.handles);
    this.highlight(scene);
    this.markings.showRegion(scene.region, scene.region_pose);
    this.markings.markThings(scene.picked, scene.refused_pair ?? []);
  }

  setCamera({ pose, scale_px }) {
    const { width, height } = this.size;
    this.camera.fov = (2 * Math.atan(height / 2 / scale_px) * 180) / Math.PI;
    this.camera.aspect = width / height;
    this.camera.near = NEAR_M;
    this.camera.far = 40 * this.graph.size;
    this.camera.updateProjectionMatrix();
    this.camera.matrix.set(...pose);
    this.camera.matrixWorldNeedsUpdate = true;
  }

  showGoal({ goal, refused_pair }) {
    this.ghost.root.visible = goal !== null;
    if (goal === null) return;
    this.ghost.setJoints(goal);
    for (const [name, parts] of this.ghost.parts) {
      const style = refused_pair === null ? "ghost" : refused_pair.includes(name) ? "touching" : "refused";
      for (const part of parts) part.material = this.ghostMaterials[style];
    }
  }

  // The planned path: dots for the tip, and some postures of the arm.
  showPlanned({ path, swept }) {
    if (path !== this.path) this.markings.showPath(path?.joints.map((positions) => this.ghost.setJoints(positions).tipPosition()) ?? []);
    if (swept !== this.swept) this.sweep.show(swept ?? []);
    Object.assign(this, { path, swept });
  }

  highlight({ hover, grabbed, behind }) {
    const marked = grabbed ?? hover;
    for (const [name, parts] of this.arm.parts) {
      for (const { material } of parts) {
        material.color.copy(material.userData.colour).lerp(this.hoverColour, name === marked ? HIGHLIGHT : 0);
        const opacity = behind && name !== marked ? BEHIND_OPACITY : 1;
        if (material.opacity !== opacity) Object.assign(material, { opacity, transparent: opacity < 1, needsUpdate: true });
      }
    }
  }

  render() {
    this.renderer.render(this.scene, this.camera);
  }

  // Compiles the shaders of everything that may be shown later, and draws none of it.
  compile() {
    if (this.renderer instanceof SoftwareRenderer) return;
    const hidden = [];
    this.scene.traverse((part) => part.visible || hidden.push(part));
    for (const part of hidden) part.visible = true;
    this.renderer.setScissor(0, 0, 1, 1);
    this.renderer.setScissorTest(true);
    this.render();
    this.renderer.setScissorTest(false);
    for (const part of hidden) part.visible = false;
  }

  // Resolves with the time of a frame, from its commands until the GPU has finished them.
  async timeFrame() {
    const gl = this.renderer.getContext();
    const start = performance.now();
    this.render();
    if (this.renderer instanceof SoftwareRenderer) return performance.now() - start;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const isDrawn = () => gl.isContextLost() || gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.SIGNALED;
    while (!isDrawn() && performance.now() - start < LONGEST_FRAME_MS) await nextTask();
    gl.deleteSync(fence);
    return performance.now() - start;
  }

  // Names of the links with T_world_link (4, 4), row by row; for tests.
  poses(tree = this.arm) {
    tree.root.updateMatrixWorld(true);
    return Object.fromEntries([...tree.nodes].map(([name, node]) => [name, node.matrixWorld.clone().transpose().elements]));
  }
}

// The links of an arm: each node is a child of its parent link and moves with its joint.
class LinkTree {
  constructor({ links, tip }, shapes, createMaterial) {
    this.nodes = new Map();
    this.parts = new Map();
    this.joints = [];
    this.uncoloured = [];
    for (const link of links) {
      const node = new THREE.Group();
      node.name = link.name;
      node.matrixAutoUpdate = false;
      node.matrix.set(...link.origin);
      this.nodes.get(link.parent)?.add(node);
      this.nodes.set(link.name, node);
      if (link.joint !== "fixed") this.joints.push(createJoint(node, link));
      const parts = shapes[link.name].map((shape) => this.createPart(shape, createMaterial));
      parts.forEach((part) => node.add(part));
      this.parts.set(link.name, parts);
    }
    this.root = this.nodes.get(links[0].name);
    this.tip = this.nodes.get(tip);
  }

  createPart({ shape, size, corners, pose, colour }, createMaterial) {
    const material = createMaterial();
    material.userData.colour = new THREE.Color();
    if (colour) material.userData.colour.setRGB(...colour, THREE.SRGBColorSpace);
    else this.uncoloured.push(material);
    const part = new THREE.Mesh(GEOMETRIES[shape](size ?? corners), material);
    part.matrixAutoUpdate = false;
    part.matrix.set(...pose);
    return part;
  }

  setDefaultColour(colour) {
    for (const material of this.uncoloured) material.userData.colour.copy(colour);
  }

  setJoints(positions) {
    const motion = new THREE.Matrix4();
    this.joints.forEach(({ node, origin, axis, slides }, i) => {
      if (slides) motion.makeTranslation(axis.clone().multiplyScalar(positions[i]));
      else motion.makeRotationAxis(axis, positions[i]);
      node.matrix.multiplyMatrices(origin, motion);
      node.matrixWorldNeedsUpdate = true;
    });
    return this;
  }

  tipPosition() {
    this.root.updateMatrixWorld(true);
    return new THREE.Vector3().setFromMatrixPosition(this.tip.matrixWorld);
  }
}

// Copies of an arm in some postures; each of its parts is drawn once for all of them.
class Sweep {
  constructor(tree, material) {
    this.tree = tree;
    this.parts = [...tree.parts.values()].flat();
    this.copies = this.parts.map(({ geometry }) => new THREE.InstancedMesh(geometry, material, MAX_SWEPT));
    this.root = new THREE.Group().add(...this.copies);
    this.show([]);
  }

  // Moves the copied arm.
  show(postures) {
    for (const copies of this.copies) Object.assign(copies, { count: postures.length, frustumCulled: false }).instanceMatrix.needsUpdate = true;
    postures.forEach((positions, i) => {
      this.tree.setJoints(positions).root.updateMatrixWorld(true);
      this.parts.forEach((part, k) => this.copies[k].setMatrixAt(i, part.matrixWorld));
    });
  }
}

function createJoint(node, { origin, axis, joint }) {
  return { node, origin: new THREE.Matrix4().set(...origin), axis: new THREE.Vector3(...axis), slides: joint === "prismatic" };
}

// Creates a shape of the kind that the server names; cylinders of URDF lie along z.
const GEOMETRIES = {
  box: (size) => new THREE.BoxGeometry(...size),
  cylinder: ([radius, length]) => new THREE.CylinderGeometry(radius, radius, length, 40).rotateX(Math.PI / 2),
  sphere: ([radius]) => new THREE.SphereGeometry(radius, 32, 20),
  capsule: ([radius, length]) => new THREE.CapsuleGeometry(radius, length, 8, 24),
  mesh(corners) {
    const bytes = Uint8Array.from(atob(corners), (letter) => letter.charCodeAt(0));
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(bytes.buffer), 3));
    geometry.computeVertexNormals();
    return geometry;
  },
};

// If ghost and arm coincide, the arm is in front, but parts that would touch are in front of it.
function createGhostMaterials() {
  const create = (opacity, offset) => new THREE.MeshStandardMaterial({
    transparent: true, opacity, roughness: 0.8, polygonOffset: true, polygonOffsetFactor: offset, polygonOffsetUnits: offset,
  });
  const swept = Object.assign(create(0.07, 2), { depthWrite: false }); // so that each posture is seen through the others
  return { swept, ghost: create(0.38, 2), refused: create(0.38, 2), touching: create(0.85, -2) };
}

function createTriad(length) {
  const triad = new THREE.Group();
  for (const [colour, [x, y, z]] of AXES) {
    const rod = new THREE.Mesh(new THREE.CylinderGeometry(length / 40, length / 40, length, 12).translate(0, length / 2, 0), new THREE.MeshBasicMaterial({ color: colour }));
    if (x) rod.rotateZ(-Math.PI / 2);
    else if (z) rod.rotateX(Math.PI / 2);
    triad.add(rod);
  }
  return triad;
}

function createLights({ centre: [x, y, z], size }) {
  const sky = new THREE.HemisphereLight(0xffffff, 0x9a948a, 1.7);
  sky.position.set(0, 0, 1);
  const sun = new THREE.DirectionalLight(0xffffff, 2.2);
  sun.position.set(x - 0.5 * size, y - 0.9 * size, z + 1.8 * size);
  sun.target.position.set(x, y, z);
  sun.castShadow = true;
  sun.shadow.mapSize.set(SHADOW_PX, SHADOW_PX);
  sun.shadow.normalBias = 0.004;
  const half = 0.9 * size;
  Object.assign(sun.shadow.camera, { left: -half, right: half, top: half, bottom: -half, near: 0.1 * size, far: 5 * size });
  return [sky, sun, sun.target];
}

// A colour of the style without its opacity, because lines and materials have their own.
function readColour(style, name) {
  return new THREE.Color(style.getPropertyValue(name).trim().slice(0, 7));
}

function nextTask() {
  return new Promise((resolve) => setTimeout(resolve, 1));
}
