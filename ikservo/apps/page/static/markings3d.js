// The surroundings of the arm in 3D: table, grid, things, reachable region, the path of the tip.

import * as THREE from "./three.min.js";

const GRID_M = 0.1;
const GRID_LINES = 10; // on each side
const PATH_DOTS = 25; // number of postures along a path that the server sends
const DOT_M = 0.0022;
const ABOVE_TABLE_M = 0.0005;

export class Markings {
  constructor(graph) {
    this.root = new THREE.Group();
    this.lines = {
      grid: new THREE.LineBasicMaterial(),
      region: new THREE.LineBasicMaterial({ transparent: true, opacity: 0.45 }),
      thing: new THREE.LineBasicMaterial({ transparent: true, opacity: 0.6 }),
    };
    this.sheet = new THREE.MeshBasicMaterial({ polygonOffset: true, polygonOffsetFactor: 4, polygonOffsetUnits: 4 });
    this.dotMaterial = new THREE.MeshBasicMaterial();
    this.dots = new THREE.InstancedMesh(new THREE.SphereGeometry(DOT_M, 10, 8), this.dotMaterial, PATH_DOTS);
    this.dots.frustumCulled = false;
    this.region = new THREE.Group();
    this.region.matrixAutoUpdate = false;
    this.things = new THREE.Group();
    this.thingColour = new THREE.Color();
    this.touchedColour = new THREE.Color();
    this.root.add(this.dots, this.region, this.things);
    this.table = graph.floor === null ? [] : this.createTable(graph);
    this.root.add(...this.table);
  }

  createTable({ centre, floor }) {
    const [x, y] = centre.map((along) => Math.round(along / GRID_M) * GRID_M);
    const half = GRID_M * GRID_LINES;
    const sheet = new THREE.PlaneGeometry(2 * half, 2 * half);
    this.shadow = new THREE.ShadowMaterial({ opacity: 0.22, polygonOffset: true, polygonOffsetFactor: 3, polygonOffsetUnits: 3 });
    const shadow = new THREE.Mesh(sheet, this.shadow);
    shadow.receiveShadow = true;
    const table = [new THREE.Mesh(sheet, this.sheet), shadow, new THREE.LineSegments(createGrid(half), this.lines.grid)];
    table.forEach((part, i) => part.position.set(x, y, floor + i * ABOVE_TABLE_M / 10 - ABOVE_TABLE_M));
    return table;
  }

  setColours(read) {
    this.dotMaterial.color.copy(read("--draw-ghost-edge"));
    this.sheet.color.copy(read("--draw-floor"));
    this.lines.grid.color.copy(read("--draw-floor-edge"));
    this.lines.region.color.copy(read("--draw-reach-edge"));
    this.thingColour.copy(read("--draw-text"));
    this.touchedColour.copy(read("--draw-bad"));
    this.lines.thing.color.copy(this.thingColour);
    for (const { children: [body] } of this.things.children) body.material.color.copy(this.thingColour);
  }

  showPath(points) {
    const place = new THREE.Matrix4();
    points.forEach((point, i) => this.dots.setMatrixAt(i, place.makeTranslation(point)));
    this.dots.count = points.length;
    this.dots.instanceMatrix.needsUpdate = true;
  }

  setThings(things) {
    for (const { children } of this.things.children) for (const { geometry } of children) geometry.dispose();
    this.things.clear();
    for (const thing of things) if (thing.drawn) this.things.add(createThing(thing, this.thingColour, this.lines.thing));
  }

  markThings(picked, touched) {
    for (const { name, children: [body] } of this.things.children) {
      body.material.opacity = [picked, ...touched].includes(name) ? 0.4 : 0.16;
      body.material.color.copy(touched.includes(name) ? this.touchedColour : this.thingColour);
    }
  }

  showRegion(rings, pose) {
    this.region.visible = rings !== null;
    if (rings === null) return;
    this.region.matrix.set(...pose);
    this.region.matrixWorldNeedsUpdate = true;
    if (rings === this.shownRings) return;
    this.shownRings = rings;
    for (const line of this.region.children) line.geometry.dispose();
    this.region.clear();
    for (const ring of rings) {
      const corners = ring.map(([u, v]) => new THREE.Vector3(u, v, 0));
      this.region.add(new THREE.LineLoop(new THREE.BufferGeometry().setFromPoints(corners), this.lines.region));
    }
  }
}

function createGrid(half) {
  const ends = [];
  for (let i = -GRID_LINES; i <= GRID_LINES; i++) {
    const at = i * GRID_M;
    ends.push([-half, at], [half, at], [at, -half], [at, half]);
  }
  return new THREE.BufferGeometry().setFromPoints(ends.map(([x, y]) => new THREE.Vector3(x, y, 0)));
}

// Creates a shape that the server names, from half its extents.
const SHAPES = {
  box: (half) => new THREE.BoxGeometry(...half.map((each) => 2 * each)),
  cylinder: ([radius, , half]) => new THREE.CylinderGeometry(radius, radius, 2 * half, 40).rotateX(Math.PI / 2),
  sphere: ([radius]) => new THREE.SphereGeometry(radius, 24, 16),
};

function createThing({ name, shape, pose, half }, colour, lines) {
  const geometry = SHAPES[shape](half);
  const thing = new THREE.Group();
  thing.name = name;
  thing.add(new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ color: colour, transparent: true, opacity: 0.12, depthWrite: false })),
    new THREE.LineSegments(new THREE.EdgesGeometry(geometry, 20), lines));
  thing.matrixAutoUpdate = false;
  thing.matrix.set(...pose);
  return thing;
}
