"use strict";
// The 3D view of a result: what stands where in a frame, and the eye that looks at it.

const MEASURED = 40;  // frames at most in which the object's lowest point is sought

/** Where one looks from, alike in all columns, which stand in a frame of their own each. */
class Eye {
  /** `near` tells how far the distances of surfaces are known; `extent` is the largest of what is looked at [m]. */
  constructor(near, extent) {
    Object.assign(this, { near, extent, reach: 0, contact: near.at, stand: "camera", viewers: [] });
    this.square = extent < 0.5 ? 0.05 : 0.1;
    this.squares = Math.min(20, Math.ceil((1.5 * extent) / this.square));  // of the grid, on each side
    this.reset();
  }

  reset() {
    Object.assign(this, { pitch: 0, yaw: 0, distance: 1.4 * this.extent, shift: [0, 0] });
    for (const viewer of this.viewers) viewer.settle();
    this.ask();
  }

  standIn(frame) {
    this.stand = frame;
    this.reset();
  }

  zoom(factor) {
    this.distance = Math.max(0.3 * this.extent, Math.min(this.farthest(), factor * this.distance));
  }

  farthest() {
    return Math.max(20 * this.extent, 6 * this.reach);
  }

  /** Step back until all cameras are in sight, which are up to `reach` away from what is looked at [m]; or return. */
  showCameras(on) {
    if (!this.reach) return;
    this.reset();
    if (on) Object.assign(this, { distance: Math.min(this.farthest(), 3 * this.reach), pitch: -0.45, yaw: 0.5 });
  }

  ask() {
    for (const viewer of this.viewers) viewer.ask();
  }
}

class Viewer {
  /** Throws where the browser has no WebGL. */
  constructor(canvas, arrays, eye) {
    const gl = canvas.getContext("webgl2", { antialias: true });
    if (!gl) throw new Error("no WebGL");
    Object.assign(this, { canvas, arrays, eye, gl, frame: 0, candidate: 0, moving: {}, waiting: false, shown: {} });
    this.program = compiled(gl);
    gl.useProgram(this.program);
    this.places = {};
    for (const name of ["T_eye_mesh", "projection", "colour", "contact", "opacity", "lit", "painted", "coloured", "border", "fades"]) {
      this.places[name] = gl.getUniformLocation(this.program, name);
    }
    const surface = (faces, colours) => new Surface(gl, this.program, faces, colours);
    this.hand = surface(arrays.hand_faces);
    if (arrays.object_faces) {
      this.object = surface(arrays.object_faces, arrays.object_colours);
      this.object.move(arrays.object_vertices);
    }
    if (arrays.other_hand_faces) this.other = surface(arrays.other_hand_faces);
    if (arrays.true_T_cam_hand) this.trueHand = surface(arrays.hand_faces);
    if (arrays.axis) {
      this.axes = Array.from({ length: arrays.axis.shape[0] }, (_, k) => {
        const ends = [...block(arrays.axis, k)];
        if (ends.some(Number.isNaN)) return null;
        const [vertices, faces] = rod(ends.slice(0, 3), ends.slice(3), 0.008 * arrays.extent[0]);
        const axis = surface(faces);
        axis.move(vertices);
        return axis;
      });
    }
    if (arrays.T_cam_views) this.cameras = this.frusta(surface);
    this.ground = this.findGround();
    this.grid = this.barred(surface, grid(this.ground.middle, this.ground.up, this.ground.height, eye.square, eye.squares), 0.0016);
    this.directions = [0, 1, 2].map((k) => this.barred(surface, [[[0, 0, 0], [0, 1, 2].map((x) => (x === k ? 0.3 * eye.extent : 0))]], 0.006));
    eye.viewers.push(this);
    this.settle();
    this.listen();
    new ResizeObserver(() => this.ask()).observe(canvas);
  }

  /** Values of a frame, of an array with one block for each frame. */
  at(name, n = this.frame) {
    return block(this.arrays[name], n);
  }

  /** The object in the hand, of the candidate that is chosen. */
  inHand(n = this.frame) {
    const frames = this.arrays.T_hand_obj.shape[1];
    const first = 16 * (this.candidate * frames + n);
    return [...this.arrays.T_hand_obj.subarray(first, first + 16)];
  }

  /** Whether the hand of the other side is known in the frame. */
  otherKnown() {
    return this.other !== undefined && this.at("other_hand_known")[0] > 0;
  }

  /** The cameras of all views, the clip's own first, and how far away they are. */
  frusta(surface) {
    const { arrays, eye } = this, middle = Math.floor(arrays.focus.shape[0] / 2), look = this.at("focus", middle);
    const n_cameras = arrays.camera_corners.shape[0];
    const away = (k) => Math.hypot(...applied(inverse(this.T_cam_view(k, middle)), look));
    eye.reach = Math.max(eye.reach, ...Array.from({ length: n_cameras }, (_, k) => away(k)));
    return Array.from({ length: n_cameras }, (_, k) => {
      const edges = frustum(block(arrays.camera_corners, k), 0.12 * eye.reach);
      return this.barred(surface, edges, (0.006 * eye.reach) / eye.extent);
    });
  }

  /** Bars along edges, of a radius as a share of the extent. */
  barred(surface, edges, radius) {
    const [vertices, faces] = rods(edges, radius * this.eye.extent), made = surface(faces);
    made.move(vertices);
    return made;
  }

  /** The level on which the grid lies, in the world where its up is known, else in the camera frame: at the ground, else at
   * the lowest point of the object in any frame; without an object, of the place to look at. */
  findGround() {
    const { arrays } = this, frames = arrays.focus.shape[0], known = Boolean(arrays.world_up);
    const up = known ? [...arrays.world_up].map((value) => value / Math.hypot(...arrays.world_up)) : [0, -1, 0];
    const T_ground_cam = (n) => (known ? [...this.at("T_world_cam", n)] : IDENTITY);
    const middle = applied(T_ground_cam(Math.floor(frames / 2)), this.at("focus", Math.floor(frames / 2)));
    if (arrays.ground_height) return { known, up, middle, height: arrays.ground_height[0], at: "on the ground" };
    if (!this.object) return { known, up, middle, height: dot(up, middle) - 0.5 * this.eye.extent, at: "below the hand" };
    const scale = arrays.scale[0], points = arrays.object_vertices;
    let height = Infinity;
    for (let n = 0; n < frames; n += Math.max(1, Math.floor(frames / MEASURED))) {
      const T = product(T_ground_cam(n), product([...this.at("T_cam_hand", n)], this.inHand(n)));
      const rise = [0, 1, 2].map((x) => scale * (up[0] * T[x] + up[1] * T[4 + x] + up[2] * T[8 + x]));
      let lowest = Infinity;
      for (let v = 0; v < points.length; v += 3) lowest = Math.min(lowest, rise[0] * points[v] + rise[1] * points[v + 1] + rise[2] * points[v + 2]);
      height = Math.min(height, lowest + up[0] * T[3] + up[1] * T[7] + up[2] * T[11]);
    }
    return { known, up, middle, height, at: "at the object's lowest point" };
  }

  /** What is drawn to measure by, in words. */
  measures() {
    const words = [];
    if (this.shown.grid) words.push(`squares of ${Math.round(100 * this.eye.square)} cm ${this.ground.at}${this.ground.known ? "" : ", level with the camera"}`);
    if (this.shown.axes) words.push(`axes of ${this.object ? "object and " : ""}camera: x red, y green, z blue`);
    return words.join("; ");
  }

  /** The pose of a camera in the frame of the clip's own one, which is camera 0. */
  T_cam_view(k, n = this.frame) {
    return k === 0 ? IDENTITY : [...this.at("T_cam_views", n).subarray(16 * (k - 1), 16 * k)];
  }

  /** The camera from which one looks; undefined in other frames. */
  standsAt() {
    const { stand } = this.eye;
    if (stand === "camera") return 0;
    return stand.startsWith("view ") ? Number(stand.slice(5)) + 1 : undefined;
  }

  /** The pose of the camera frame in the frame to stand in. */
  T_stand_cam() {
    const T_hand_cam = inverse([...this.at("T_cam_hand")]), { stand } = this.eye;
    if (this.standsAt() !== undefined) return inverse(this.T_cam_view(this.standsAt()));
    if (stand === "world") return [...this.at("T_world_cam")];
    if (stand === "hand") return T_hand_cam;
    return product(inverse(this.inHand()), T_hand_cam);
  }

  /** Where to look and how the eye is turned before anybody turns it: as the image of the middle frame shows it; in the
   * world with its up upwards, about which the eye then turns. */
  settle() {
    const middle = Math.floor(this.arrays.focus.shape[0] / 2), { frame } = this;
    this.frame = middle;
    const T = this.T_stand_cam();
    this.frame = frame;
    const axes = this.standsAt() === undefined ? T : IDENTITY;
    const [right, down, forward] = [0, 1, 2].map((n) => [axes[n], axes[4 + n], axes[8 + n]]);
    const up = this.eye.stand === "world" && this.arrays.world_up;
    const level = up ? upright(down, forward, up) : { right, down, forward, tilt: 0 };
    this.tilt = level.tilt;
    this.ahead = [...level.right, 0, ...level.down, 0, ...level.forward, 0, 0, 0, 0, 1];
    this.look = applied(T, this.at("focus", middle));
  }

  /** Show a frame of a candidate; `moving` has what changes from frame to frame. */
  show(frame, candidate, moving) {
    Object.assign(this, { frame, candidate, moving });
    this.hand.move(moving.hand_vertices, moving.hand_near);
    if (this.other) this.other.move(moving.other_hand_vertices, moving.other_hand_near);
    if (this.trueHand) this.trueHand.move(moving.true_hand_vertices || moving.hand_vertices);
    if (moving.object_near) this.object.put("touch", moving.object_near);
    this.ask();
  }

  ask() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      if (this.moving.hand_vertices && this.canvas.isConnected) this.draw();  // not of an entry that was left
    });
  }

  T_eye_stand() {
    const { pitch, yaw, shift, distance } = this.eye;
    const look = this.standsAt() === undefined ? this.look : applied(this.T_stand_cam(), this.at("focus"));
    const back = [1, 0, 0, -look[0], 0, 1, 0, -look[1], 0, 0, 1, -look[2], 0, 0, 0, 1];
    const out = product(turn(this.tilt + pitch, yaw), product(this.ahead, back));
    out[3] += shift[0];
    out[7] += shift[1];
    out[11] += distance;
    return out;
  }

  draw() {
    const { gl, canvas, arrays, shown, places, eye } = this;
    const width = Math.max(1, Math.round(canvas.clientWidth * devicePixelRatio));
    const height = Math.max(1, Math.round(canvas.clientHeight * devicePixelRatio));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clearColor(...getComputedStyle(canvas.parentElement).backgroundColor.match(/[0-9.]+/g).slice(0, 3).map((level) => level / 255), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const near = 0.02 * eye.distance, far = 3 * eye.distance + 10 * eye.extent;
    const [f, side] = [2.6, Math.min(width, height)];
    gl.uniformMatrix4fv(places.projection, true, [
      (f * side) / width, 0, 0, 0, 0, (-f * side) / height, 0, 0,
      0, 0, (far + near) / (far - near), (-2 * far * near) / (far - near), 0, 0, 1, 0,
    ]);
    gl.uniform1f(places.border, 1 - eye.contact / eye.near.reach);
    gl.uniform1f(places.fades, eye.near.fades / eye.near.reach);
    const T_eye_cam = product(this.T_eye_stand(), this.T_stand_cam());
    const T_eye_hand = product(T_eye_cam, [...this.at("T_cam_hand")]);
    const coloured = shown.contact && this.moving.object_near !== undefined;
    if (shown.hand) this.part(this.hand, T_eye_hand, SHOWN.hand, { coloured });
    if (shown.hand && this.otherKnown()) {
      this.part(this.other, product(T_eye_cam, [...this.at("T_cam_other_hand")]), SHOWN.hand, { coloured });
    }
    if (shown.cameras) {
      this.cameras.forEach((camera, k) => this.part(camera, product(T_eye_cam, this.T_cam_view(k)), redGreenBlue(cameraColour(k)), { lit: 0 }));
    }
    if (shown.grid) this.part(this.grid, this.ground.known ? product(T_eye_cam, inverse([...this.at("T_world_cam")])) : T_eye_cam, SHOWN.grid, { lit: 0 });
    if (shown.axes) this.three(T_eye_cam);
    if (!this.object) return;
    if (shown.axes) this.three(product(T_eye_hand, this.inHand()));
    const T_eye_obj = scaled(product(T_eye_hand, this.inHand()), arrays.scale[this.candidate]);
    if (shown.object) this.part(this.object, T_eye_obj, SHOWN.object, { coloured, painted: Boolean(arrays.object_colours) });
    const axis = shown.axis && this.axes && this.axes[this.candidate];
    if (axis) {
      gl.depthFunc(gl.GREATER);  // where something is in front of it
      gl.depthMask(false);
      this.part(axis, T_eye_hand, SHOWN.hidden, { opacity: 0.55, lit: 0 });
      gl.depthFunc(gl.LESS);
      gl.depthMask(true);
      this.part(axis, T_eye_hand, SHOWN.axis);
    }
    if (shown.true && arrays.true_T_cam_obj) {
      this.ghost(this.object, scaled(product(T_eye_cam, [...this.at("true_T_cam_obj")]), arrays.true_scale[0]));
      if (this.moving.true_hand_vertices) this.ghost(this.trueHand, product(T_eye_cam, [...this.at("true_T_cam_hand")]));
    }
  }

  /** The axes of a frame, as large on the screen as if they were where one looks, or smaller. */
  three(T_eye_frame) {
    const size = Math.max(0.05, Math.min(1, T_eye_frame[11] / this.eye.distance));
    this.directions.forEach((one, k) => this.part(one, scaled(T_eye_frame, size), AXES[k], { lit: 0 }));
  }

  ghost(surface, T_eye_mesh) {
    const { gl } = this;
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 8);  // a little behind what it agrees with, lest the two flicker
    gl.colorMask(false, false, false, false);  // depth first, or one would look through it into itself
    this.part(surface, T_eye_mesh, SHOWN.truth);
    gl.colorMask(true, true, true, true);
    gl.depthFunc(gl.EQUAL);
    this.part(surface, T_eye_mesh, SHOWN.truth, { opacity: 0.55 });
    gl.depthFunc(gl.LESS);
    gl.disable(gl.POLYGON_OFFSET_FILL);
  }

  part(surface, T_eye_mesh, colour, { opacity = 1, lit = 1, painted = false, coloured = false } = {}) {
    const { gl, places } = this;
    gl.uniformMatrix4fv(places.T_eye_mesh, true, T_eye_mesh);
    gl.uniform3fv(places.colour, colour);
    gl.uniform3fv(places.contact, SHOWN.contact);
    gl.uniform1f(places.opacity, opacity);
    gl.uniform1f(places.lit, lit);
    gl.uniform1f(places.painted, painted ? 1 : 0);
    gl.uniform1f(places.coloured, coloured ? 1 : 0);
    surface.draw();
  }

  listen() {
    const { canvas, eye } = this, pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (event) => pointers.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
      if (pointers.size === 2) {
        const [other] = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
        const apart = (x, y) => Math.hypot(x - other[0], y - other[1]) || 1;
        eye.zoom(apart(...before) / apart(event.clientX, event.clientY));
      } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) {
        const metres = eye.distance / (2.6 * 0.5 * Math.min(canvas.clientWidth, canvas.clientHeight));
        eye.shift = [eye.shift[0] + dx * metres, eye.shift[1] + dy * metres];
      } else {
        eye.yaw += 0.008 * dx;
        eye.pitch = Math.max(-1.57, Math.min(1.57, eye.pitch - 0.008 * dy));
      }
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      eye.ask();
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      eye.zoom(Math.exp(0.001 * event.deltaY));
      eye.ask();
    }, { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", () => eye.reset());
  }
}
