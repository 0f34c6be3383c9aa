// Rotations as quaternions w, x, y, z; z is upwards.

const LEVEL = 0.25; // shortest horizontal part of a direction of length √2 that has a heading

export function multiply([a, b, c, d], [w, x, y, z]) {
  return [
    a * w - b * x - c * y - d * z,
    a * x + b * w + c * z - d * y,
    a * y - b * z + c * w + d * x,
    a * z + b * y - c * x + d * w,
  ];
}

export const yaw = (angle) => [Math.cos(angle / 2), 0, 0, Math.sin(angle / 2)];

export function turnAboutZ([x, y, z], angle) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return [cos * x - sin * y, sin * x + cos * y, z];
}

// The angles of a deviceorientation event, in degrees: about z, then x, then y.
export function fromAngles(alpha, beta, gamma) {
  const about = (degrees, axis) => {
    const half = (degrees * Math.PI) / 360;
    return [Math.cos(half), ...[0, 1, 2].map((i) => (i === axis ? Math.sin(half) : 0))];
  };
  return multiply(multiply(about(alpha, 2), about(beta, 0)), about(gamma, 1));
}

// The direction in which a device points, from x towards y: between its back and its upper edge, so
// that it may be upright or flat; null if that is too steep.
export function heading(rotation) {
  const [w, x, y, z] = rotation;
  const turned = multiply(multiply(rotation, [0, 0, 1, -1]), [w, -x, -y, -z]);
  return Math.hypot(turned[1], turned[2]) < LEVEL ? null : Math.atan2(turned[2], turned[1]);
}
