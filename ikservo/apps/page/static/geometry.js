// Vectors are [x, y, z]; poses are (4, 4) row by row, as the server sends them.

export const add = (a, b, factor = 1) => [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]];
export const subtract = (a, b) => add(a, b, -1);
export const scale = (a, factor) => [factor * a[0], factor * a[1], factor * a[2]];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a) => Math.sqrt(dot(a, a));
export const unit = (a) => scale(a, 1 / Math.max(length(a), 1e-12));

export const column = (T, i) => [T[i], T[4 + i], T[8 + i]];
export const origin = (T) => column(T, 3);
export const rotate = (T, [x, y, z]) => [T[0] * x + T[1] * y + T[2] * z, T[4] * x + T[5] * y + T[6] * z, T[8] * x + T[9] * y + T[10] * z];
export const transform = (T, point) => add(rotate(T, point), origin(T));

export function multiply(A, B) {
  const product = [];
  for (let row = 0; row < 16; row += 4) {
    for (let i = 0; i < 4; i++) product.push(A[row] * B[i] + A[row + 1] * B[4 + i] + A[row + 2] * B[8 + i] + A[row + 3] * B[12 + i]);
  }
  return product;
}

export const translation = ([x, y, z]) => [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1];

// Rodrigues' formula I + sin W + (1 - cos) W², which leaves points on a coordinate axis exactly where they are.
export function rotation([x, y, z], angle) {
  const [s, c] = [Math.sin(angle), 1 - Math.cos(angle)];
  return [
    1 + c * (x * x - 1), c * x * y - s * z, c * x * z + s * y, 0,
    c * x * y + s * z, 1 + c * (y * y - 1), c * y * z - s * x, 0,
    c * x * z - s * y, c * y * z + s * x, 1 + c * (z * z - 1), 0,
    0, 0, 0, 1,
  ];
}
