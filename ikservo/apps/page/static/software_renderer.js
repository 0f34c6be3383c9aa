// Draws a scene of three.js on the CPU, for computers on which no graphics card draws WebGL: shaded
// triangles and lines with a depth buffer, and the shadow of the arm on the table. It has the
// properties and methods of WebGLRenderer that scene3d.js uses.

import * as THREE from "./three.min.js";

const MAX_SHADE = 255; // of the table with the shades of a colour
const OFFSET = 4e-4; // fraction of its distance by which a unit of polygon offset moves a surface
const ABOVE = 1.001; // factor of the nearness of what lies on a surface: lines, and shadows
const GROUND = 0.32; // light from below, as a fraction of the light from above

export class SoftwareRenderer {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.ratio = 1;
    this.shadowMap = {};
    this.shades = new Map(); // table of shades by colour
    this.growTo(1024);
  }

  getContext() {
    return this.context;
  }

  setPixelRatio(ratio) {
    this.ratio = ratio;
  }

  setSize(width, height) {
    [this.width, this.height] = [width, height].map((side) => Math.max(Math.round(side * this.ratio), 1));
    Object.assign(this.canvas, { width: this.width, height: this.height });
    this.image = this.context.createImageData(this.width, this.height);
    this.pixels = new Uint32Array(this.image.data.buffer); // little-endian: alpha, blue, green, red
    this.nearest = new Float32Array(this.pixels.length); // nearness (1 / distance) of what is drawn
  }

  // Makes room for n corners: clip coordinates, pixels, nearness and shade.
  growTo(n) {
    for (const name of ["clipX", "clipY", "distance", "x", "y", "nearness", "shade"]) this[name] = new Float32Array(n);
  }

  render(scene, camera) {
    if (!this.image) return;
    scene.updateMatrixWorld();
    camera.updateMatrixWorld();
    this.pixels.fill(0);
    this.nearest.fill(0);
    this.closestM = camera.near;
    this.view = camera.projectionMatrix.clone().multiply(camera.matrixWorldInverse);
    const parts = [];
    scene.traverseVisible((part) => {
      if (part.isDirectionalLight) this.sun = part;
      else if (part.isHemisphereLight) this.sky = part;
      else if (part.geometry && part.material.visible && part.material.opacity) parts.push(part);
    });
    this.toSun = this.sun.position.clone().sub(this.sun.target.position).normalize();
    const order = ({ material }) => 2 * !material.depthTest + material.transparent;
    const eye = new THREE.Vector3().setFromMatrixPosition(camera.matrixWorld);
    for (const part of parts) part.userData.awayM = eye.distanceTo(new THREE.Vector3().setFromMatrixPosition(part.matrixWorld));
    const isBehind = (a, b) => (a.material.transparent ? b.userData.awayM - a.userData.awayM : 0); // seen through the others
    for (const part of parts.sort((a, b) => order(a) - order(b) || isBehind(a, b))) {
      if (!part.isMesh) this.drawLines(part);
      else if (part.material.isShadowMaterial) this.drawShadows(part, parts.filter((each) => each.castShadow));
      else for (const pose of posesOf(part)) this.drawMesh(part.geometry, pose, this.paintOf(part.material));
    }
    this.context.putImageData(this.image, 0, 0);
  }

  paintOf(material) {
    const { color, transparent, opacity, depthTest, depthWrite, polygonOffset, polygonOffsetFactor } = material;
    const hex = color.getHex();
    if (!this.shades.has(hex)) this.shades.set(hex, Uint32Array.from({ length: MAX_SHADE + 1 }, (_, i) => packed(color.clone().multiplyScalar(i / MAX_SHADE))));
    return {
      shades: this.shades.get(hex), alpha: transparent ? opacity : 1, depthTest, depthWrite,
      isLit: Boolean(material.isMeshStandardMaterial), isOpen: material.side !== 0, above: 1,
      offset: polygonOffset ? 1 - OFFSET * polygonOffsetFactor : 1,
    };
  }

  // Draws the shadows of parts on the plane of a sheet, without darkening a pixel twice.
  drawShadows(sheet, casting) {
    if (!this.sun.castShadow) return;
    const z = sheet.matrixWorld.elements[14];
    const { x, y } = this.toSun.clone().divideScalar(this.toSun.z);
    const flatten = new THREE.Matrix4().set(1, 0, -x, x * z, 0, 1, -y, y * z, 0, 0, 0, z, 0, 0, 0, 1);
    const paint = { ...this.paintOf(sheet.material), isOpen: true, depthWrite: true, above: ABOVE };
    for (const part of casting) this.drawMesh(part.geometry, flatten.clone().multiply(part.matrixWorld), paint);
  }

  drawMesh({ attributes, index }, pose, paint) {
    this.place(attributes.position.array, pose, paint.offset);
    if (paint.isLit) this.illuminate(attributes.normal.array, pose.elements);
    else this.shade.fill(MAX_SHADE, 0, attributes.position.count);
    const count = index ? index.count : attributes.position.count;
    for (let i = 0; i < count; i += 3) {
      if (index) this.drawTriangle(index.array[i], index.array[i + 1], index.array[i + 2], paint);
      else this.drawTriangle(i, i + 1, i + 2, paint);
    }
  }

  // Computes the pixels of points (n, 3).
  place(points, pose, offset) {
    const m = this.view.clone().multiply(pose).elements;
    const n = points.length / 3;
    if (n + 2 > this.x.length) this.growTo(2 * n + 2); // two more for clipped triangles
    this.spare = n;
    for (let i = 0; i < n; i++) {
      const [x, y, z] = [points[3 * i], points[3 * i + 1], points[3 * i + 2]];
      this.clipX[i] = m[0] * x + m[4] * y + m[8] * z + m[12];
      this.clipY[i] = m[1] * x + m[5] * y + m[9] * z + m[13];
      this.distance[i] = m[3] * x + m[7] * y + m[11] * z + m[15];
      this.project(i, offset);
    }
  }

  project(i, offset) {
    const nearness = 1 / this.distance[i];
    this.x[i] = this.width * (0.5 + 0.5 * this.clipX[i] * nearness);
    this.y[i] = this.height * (0.5 - 0.5 * this.clipY[i] * nearness);
    this.nearness[i] = nearness * offset;
  }

  // The diffuse light of WebGLRenderer: sun, and sky with the ground below.
  illuminate(normals, m) {
    const { toSun: { x, y, z }, sun, sky } = this;
    for (let i = 0; 3 * i < normals.length; i++) {
      const [a, b, c] = [normals[3 * i], normals[3 * i + 1], normals[3 * i + 2]];
      const up = m[2] * a + m[6] * b + m[10] * c;
      const facing = x * (m[0] * a + m[4] * b + m[8] * c) + y * (m[1] * a + m[5] * b + m[9] * c) + z * up;
      const light = sky.intensity * (GROUND + (1 - GROUND) * (0.5 + 0.5 * up)) + sun.intensity * Math.max(facing, 0);
      this.shade[i] = MAX_SHADE * Math.min(light / Math.PI, 1);
    }
  }

  drawTriangle(a, b, c, paint) {
    const { distance, closestM } = this;
    const inside = [a, b, c].filter((i) => distance[i] >= closestM);
    if (inside.length === 3) this.fillTriangle(a, b, c, paint);
    if (!inside.length || inside.length === 3) return;
    // The first corner is alone on its side of the near plane; the corners keep their order.
    const isAlone = (i) => (distance[i] >= closestM) === (inside.length === 1);
    const [first, second, third] = isAlone(a) ? [a, b, c] : isAlone(b) ? [b, c, a] : [c, a, b];
    const [left, right] = [this.cut(first, second, this.spare, paint), this.cut(first, third, this.spare + 1, paint)];
    if (inside.length === 1) return this.fillTriangle(first, left, right, paint);
    this.fillTriangle(left, second, third, paint);
    this.fillTriangle(left, third, right, paint);
  }

  // Places corner k where the edge from i to j meets the near plane.
  cut(i, j, k, { offset }) {
    const share = (this.closestM - this.distance[i]) / (this.distance[j] - this.distance[i]);
    for (const row of [this.clipX, this.clipY, this.distance, this.shade]) row[k] = row[i] + share * (row[j] - row[i]);
    this.project(k, offset);
    return k;
  }

  fillTriangle(a, b, c, paint) {
    const { x, y, nearness, shade, width } = this;
    let area = (x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a]); // negative in front
    if (area === 0 || (area > 0 && !paint.isOpen)) return;
    if (area > 0) [b, c, area] = [c, b, -area];
    const nearAlong = ((nearness[b] - nearness[a]) * (y[c] - y[a]) - (nearness[c] - nearness[a]) * (y[b] - y[a])) / area;
    const nearDown = ((nearness[c] - nearness[a]) * (x[b] - x[a]) - (nearness[b] - nearness[a]) * (x[c] - x[a])) / area;
    const shadeAlong = ((shade[b] - shade[a]) * (y[c] - y[a]) - (shade[c] - shade[a]) * (y[b] - y[a])) / area;
    const shadeDown = ((shade[c] - shade[a]) * (x[b] - x[a]) - (shade[b] - shade[a]) * (x[c] - x[a])) / area;
    const first = Math.max(Math.ceil(Math.min(y[a], y[b], y[c]) - 0.5), 0);
    const end = Math.min(Math.ceil(Math.max(y[a], y[b], y[c]) - 0.5), this.height);
    for (let row = first; row < end; row++) {
      const [middle, start] = [row + 0.5, row * width];
      const from = Math.max(this.leftEnd(a, b, middle), this.leftEnd(b, c, middle), this.leftEnd(c, a, middle), 0);
      const to = Math.min(this.rightEnd(a, b, middle), this.rightEnd(b, c, middle), this.rightEnd(c, a, middle), width);
      const [along, down] = [from + 0.5 - x[a], middle - y[a]];
      this.fillRow(start + from, start + to, nearness[a] + along * nearAlong + down * nearDown, nearAlong,
        shade[a] + along * shadeAlong + down * shadeDown, shadeAlong, paint);
    }
  }

  // Edges of a triangle in front go down on its left, and up on its right.
  leftEnd(i, j, at) {
    return this.y[j] > this.y[i] ? this.crossing(i, j, at) : -Infinity;
  }

  rightEnd(i, j, at) {
    return this.y[j] < this.y[i] ? this.crossing(i, j, at) : Infinity;
  }

  // The first pixel of a row whose middle is right of an edge.
  crossing(i, j, at) {
    return Math.ceil(this.x[i] + ((at - this.y[i]) * (this.x[j] - this.x[i])) / (this.y[j] - this.y[i]) - 0.5);
  }

  // The first loop, for opaque surfaces, draws most pixels and takes two thirds of the time of the second.
  fillRow(from, to, near, nearAlong, shade, shadeAlong, { shades, alpha, depthTest, depthWrite, above }) {
    const { pixels, nearest } = this;
    if (alpha === 1 && depthTest && depthWrite) {
      for (let i = from; i < to; i++, near += nearAlong, shade += shadeAlong) {
        if (near <= nearest[i]) continue;
        pixels[i] = shades[shade < 0 ? 0 : shade > MAX_SHADE ? MAX_SHADE : shade | 0];
        nearest[i] = near * above;
      }
      return;
    }
    for (let i = from; i < to; i++, near += nearAlong, shade += shadeAlong) {
      if (depthTest && near <= nearest[i]) continue;
      const colour = shades[shade < 0 ? 0 : shade > MAX_SHADE ? MAX_SHADE : shade | 0];
      pixels[i] = alpha === 1 ? colour : blended(pixels[i], colour, alpha);
      if (depthWrite) nearest[i] = near * above;
    }
  }

  drawLines(part) {
    const paint = this.paintOf(part.material);
    const points = part.geometry.attributes.position.array;
    this.place(points, part.matrixWorld, ABOVE);
    const n = points.length / 3;
    const end = part.isLineLoop ? n : n - 1;
    for (let i = 0; i < end; i += part.isLineSegments ? 2 : 1) this.drawLine(i, (i + 1) % n, { ...paint, offset: ABOVE });
  }

  drawLine(i, j, paint) {
    const { distance, closestM, x, y, nearness, width } = this;
    if (distance[i] < closestM && distance[j] < closestM) return;
    if (distance[i] < closestM) i = this.cut(i, j, this.spare, paint);
    if (distance[j] < closestM) j = this.cut(i, j, this.spare, paint);
    const [right, down] = [x[j] - x[i], y[j] - y[i]];
    let [from, to] = [0, 1]; // the part of the line inside the picture
    for (const [start, change, size] of [[x[i], right, width], [y[i], down, this.height]]) {
      if (change === 0 && (start < 0 || start >= size)) return;
      if (change !== 0) {
        from = Math.max(from, Math.min(-start / change, (size - 1 - start) / change));
        to = Math.min(to, Math.max(-start / change, (size - 1 - start) / change));
      }
    }
    const steps = Math.ceil(Math.max(Math.abs(right), Math.abs(down)) * (to - from));
    for (let k = 0; k < steps; k++) {
      const share = from + ((to - from) * k) / steps;
      const near = nearness[i] + share * (nearness[j] - nearness[i]);
      const [column, row] = [Math.trunc(x[i] + share * right), Math.trunc(y[i] + share * down)];
      const end = Math.min(column + this.ratio, width);
      for (let each = row; each < row + this.ratio; each++) this.fillRow(each * width + column, each * width + end, near, 0, MAX_SHADE, 0, paint);
    }
  }
}

function posesOf(part) {
  if (!part.isInstancedMesh) return [part.matrixWorld];
  return Array.from({ length: part.count }, (_, i) => new THREE.Matrix4().fromArray(part.instanceMatrix.array, 16 * i).premultiply(part.matrixWorld));
}

function packed(colour) {
  const hex = colour.getHex(); // red, green, blue
  return ((255 << 24) | ((hex & 255) << 16) | (hex & 0xff00) | (hex >> 16)) >>> 0;
}

function blended(under, over, alpha) {
  const below = ((under >>> 24) / 255) * (1 - alpha);
  const all = alpha + below;
  let mixed = Math.round(255 * all) << 24;
  for (let shift = 0; shift < 24; shift += 8) mixed |= Math.round((((over >> shift) & 255) * alpha + ((under >> shift) & 255) * below) / all) << shift;
  return mixed >>> 0;
}
