"use strict";
// Meshes in WebGL: hands, object, axis and the true object, with one light and a camera that turns about them.
// Matrices are 4x4, row by row, as in the arrays; `T_a_b` maps points of frame b into frame a. The eye's axes are those
// of the images' camera: x right, y down, z forward.

const SHOWN = {
  object: [0.44, 0.58, 0.69], hand: [0.87, 0.72, 0.63], contact: [0.784, 0.333, 0.239], truth: [0.3, 0.33, 0.36],
  axis: [0.165, 0.616, 0.561], hidden: [0.66, 0.88, 0.835], grid: [0.545, 0.565, 0.584],
};
const AXES = [[0.85, 0.2, 0.17], [0.2, 0.62, 0.26], [0.2, 0.42, 0.88]];  // x, y, z
const CAMERAS = ["#7d858c", "#2a7f9e", "#d19a2a", "#7b5ea7", "#4f8a4f", "#c8553d", "#a0466f", "#5277a8"];  // the clip's own first
const cameraColour = (k) => CAMERAS[k && 1 + ((k - 1) % (CAMERAS.length - 1))];
const redGreenBlue = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);

const VERTEX = `#version 300 es
uniform mat4 T_eye_mesh, projection;
in vec3 position, normal, paint;
in float touch;
out vec3 at, across, painting;
out float touching;
void main() {
  vec4 point = T_eye_mesh * vec4(position, 1.0);
  at = point.xyz;
  across = mat3(T_eye_mesh) * normal;
  touching = touch;
  painting = paint;
  gl_Position = projection * point;
}`;
const FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 colour, contact;
uniform float opacity, lit, painted, coloured, border, fades;  // contact is where touching is above the border
in vec3 at, across, painting;
in float touching;
out vec4 pixel;
void main() {
  vec3 n = normalize(across), to_eye = -normalize(at);
  if (dot(n, to_eye) < 0.0) n = -n;  // the inside of an open mesh is lit as well
  float light = 0.3 + 0.5 * max(dot(n, normalize(vec3(-0.35, -0.6, -0.72))), 0.0) + 0.3 * abs(dot(n, to_eye));
  float met = coloured * clamp(0.5 + (touching - border) / (2.0 * fades), 0.0, 1.0);
  pixel = vec4(min(mix(mix(colour, painting, painted), contact, met) * mix(1.0, light, lit), 1.0), 1.0) * opacity;
}`;

const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

function product(a, b) {
  const out = new Array(16).fill(0);
  for (let i = 0; i < 4; i += 1) {
    for (let j = 0; j < 4; j += 1) for (let k = 0; k < 4; k += 1) out[4 * i + j] += a[4 * i + k] * b[4 * k + j];
  }
  return out;
}

/** Inverse of a rigid motion. */
function inverse(T) {
  const out = [...IDENTITY];
  for (let i = 0; i < 3; i += 1) {
    for (let j = 0; j < 3; j += 1) out[4 * i + j] = T[4 * j + i];
    out[4 * i + 3] = -(T[i] * T[3] + T[4 + i] * T[7] + T[8 + i] * T[11]);
  }
  return out;
}

const scaled = (T, s) => T.map((value, n) => (n < 12 && n % 4 < 3 ? s * value : value));
const applied = (T, x) => [0, 4, 8].map((row) => T[row] * x[0] + T[row + 1] * x[1] + T[row + 2] * x[2] + T[row + 3]);

/** A turn about the eye's axis x (down is positive), after one about its axis y. */
function turn(pitch, yaw) {
  const [a, b, c, d] = [Math.cos(pitch), Math.sin(pitch), Math.cos(yaw), Math.sin(yaw)];
  return product([1, 0, 0, 0, 0, a, -b, 0, 0, b, a, 0, 0, 0, 0, 1], [c, 0, d, 0, 0, 1, 0, 0, -d, 0, c, 0, 0, 0, 0, 1]);
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** The axes of an eye that looks where another does, upright, and how far it has yet to be tilted down for that. */
function upright(down, forward, up) {
  const below = [...up].map((value) => -value / Math.hypot(...up)), sine = dot(forward, below);
  const ahead = Math.abs(sine) < 0.98 ? forward : down.map((value) => -Math.sign(sine) * value);  // straight down, or up
  const level = ahead.map((value, n) => value - dot(ahead, below) * below[n]);
  const straight = level.map((value) => value / Math.hypot(...level));
  return { right: cross(below, straight), down: below, forward: straight, tilt: Math.asin(Math.max(-1, Math.min(1, sine))) };
}

/** Unit normals of vertices: the sum of their faces', by the angles at the vertex. */
function normalsOf(vertices, faces) {
  const out = new Float32Array(vertices.length);
  for (let f = 0; f < faces.length; f += 3) {
    const ids = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
    const sides = ids.map((id, n) => [0, 1, 2].map((x) => vertices[ids[(n + 1) % 3] + x] - vertices[id + x]));
    const across = cross(sides[0], sides[1]), area = Math.hypot(...across);
    if (area === 0) continue;
    ids.forEach((id, n) => {
      const angle = Math.atan2(area, -dot(sides[n], sides[(n + 2) % 3]));
      for (let x = 0; x < 3; x += 1) out[id + x] += (angle / area) * across[x];
    });
  }
  for (let v = 0; v < out.length; v += 3) {
    const length = Math.hypot(out[v], out[v + 1], out[v + 2]) || 1;
    for (let x = 0; x < 3; x += 1) out[v + x] /= length;
  }
  return out;
}

/** A thin rod from one point to another. */
function rod(from, to, radius, sides = 12) {
  const along = to.map((value, n) => value - from[n]);
  const length = Math.hypot(...along);
  const other = Math.abs(along[0]) < 0.6 * length ? [1, 0, 0] : [0, 1, 0];
  const unit = (a) => a.map((value) => value / Math.hypot(...a));
  const u = unit(cross(along, other)), v = unit(cross(along, u));
  const vertices = [], faces = [];
  for (let n = 0; n < sides; n += 1) {
    const [c, s] = [Math.cos((2 * Math.PI * n) / sides), Math.sin((2 * Math.PI * n) / sides)];
    for (const end of [from, to]) vertices.push(...end.map((x, k) => x + radius * (c * u[k] + s * v[k])));
    const next = (n + 1) % sides;
    faces.push(2 * n, 2 * n + 1, 2 * next, 2 * n + 1, 2 * next + 1, 2 * next);
  }
  return [new Float32Array(vertices), new Uint16Array(faces)];
}

/** Rods between pairs of points, in one mesh. */
function rods(edges, radius) {
  const vertices = [], faces = [];
  for (const [from, to] of edges) {
    const [points, corners] = rod(from, to, radius, 6), before = vertices.length / 3;
    vertices.push(...points);
    faces.push(...corners.map((id) => id + before));
  }
  return [new Float32Array(vertices), new Uint16Array(faces)];
}

/** Edges along what a camera sees, from it to the corners of its image at a depth, and around the image. */
function frustum(corners, depth) {
  const ends = [0, 1, 2, 3].map((k) => [0, 1, 2].map((x) => depth * corners[3 * k + x]));
  return ends.flatMap((end, k) => [[[0, 0, 0], end], [end, ends[(k + 1) % 4]]]);
}

/** Edges of a level grid around a point: `up` is a unit vector, `side` the length of a square, of which `count` lie on each
 * side of the point; their corners are whole squares away from the frame's origin. */
function grid(middle, up, height, side, count) {
  const other = Math.abs(up[0]) < 0.6 ? [1, 0, 0] : [0, 0, 1], across = cross(up, other);
  const u = across.map((value) => value / Math.hypot(...across)), v = cross(up, u);
  const [a, b] = [u, v].map((along) => Math.round(dot(along, middle) / side));
  const point = (i, j) => [0, 1, 2].map((x) => side * ((a + i) * u[x] + (b + j) * v[x]) + height * up[x]);
  const lines = Array.from({ length: 2 * count + 1 }, (_, k) => k - count);
  return lines.flatMap((k) => [[point(k, -count), point(k, count)], [point(-count, k), point(count, k)]]);
}

/** A surface on the graphics card. */
class Surface {
  /** `colours`: red, green and blue of each vertex, if it has its own. */
  constructor(gl, program, faces, colours) {
    Object.assign(this, { gl, faces, count: faces.length, wide: faces instanceof Uint32Array, buffers: {} });
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
    const values = [["position", 3, gl.FLOAT], ["normal", 3, gl.FLOAT], ["touch", 1, gl.UNSIGNED_BYTE]];
    if (colours) values.push(["paint", 3, gl.UNSIGNED_BYTE]);
    for (const [name, length, type] of values) {
      const place = gl.getAttribLocation(program, name);
      this.buffers[name] = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, length, type, type === gl.UNSIGNED_BYTE, 0, 0);
    }
    if (colours) this.put("paint", colours);
  }

  put(name, values) {
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.buffers[name]);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, values, this.gl.DYNAMIC_DRAW);
  }

  /** `near`: of each vertex, how near it is to the other surface, if that is known. */
  move(vertices, near = new Uint8Array(vertices.length / 3)) {
    this.put("position", vertices);
    this.put("normal", normalsOf(vertices, this.faces));
    this.put("touch", near);
  }

  draw() {
    const { gl } = this;
    gl.bindVertexArray(this.array);
    gl.drawElements(gl.TRIANGLES, this.count, this.wide ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT, 0);
  }
}

/** A program of two shaders. Throws with the compiler's words. */
function compiled(gl) {
  const program = gl.createProgram();
  for (const [kind, code] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, code);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "no shaders");
  return program;
}
