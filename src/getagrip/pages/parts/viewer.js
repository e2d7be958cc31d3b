"use strict";
// The 3D view of a result: what stands where in a frame, and the eye that looks at it.

class Viewer {
  /** Throws where the browser has no WebGL. */
  constructor(canvas, arrays) {
    const gl = canvas.getContext("webgl2", { antialias: true });
    if (!gl) throw new Error("no WebGL");
    Object.assign(this, { canvas, arrays, gl, frame: 0, candidate: 0, stand: "camera", waiting: false });
    this.shown = { hand: true, object: true, axis: true, truth: false, contact: false };
    this.program = compiled(gl);
    gl.useProgram(this.program);
    this.places = {};
    for (const name of ["T_eye_mesh", "projection", "colour", "contact", "opacity", "lit", "coloured"]) {
      this.places[name] = gl.getUniformLocation(this.program, name);
    }
    const surface = (faces) => new Surface(gl, this.program, faces);
    this.object = surface(arrays.object_faces);
    this.object.move(arrays.object_vertices);
    this.hand = surface(arrays.hand_faces);
    if (arrays.other_hand_vertices) this.other = surface(arrays.other_hand_faces);
    this.size = this.extent();
    if (arrays.axis) {
      const [vertices, faces] = rod([...arrays.axis.slice(0, 3)], [...arrays.axis.slice(3)], 0.008 * this.size);
      this.axis = surface(faces);
      this.axis.move(vertices);
    }
    this.reset();
    this.listen();
    new ResizeObserver(() => this.ask()).observe(canvas);
    this.show(0);
  }

  /** Values of a frame, of an array with one block for each frame. */
  at(name, n = this.frame) {
    const length = this.arrays[name].length / this.arrays[name].shape[0];
    return this.arrays[name].subarray(n * length, (n + 1) * length);
  }

  /** The object in the hand, of the candidate that is chosen. */
  inHand(n = this.frame) {
    const frames = this.arrays.T_hand_obj.shape[1];
    const first = 16 * (this.candidate * frames + n);
    return [...this.arrays.T_hand_obj.subarray(first, first + 16)];
  }

  /** Whether the hand of the other side is known in a frame. */
  otherKnown(n = this.frame) {
    return this.other !== undefined && this.at("other_hand_known", n)[0] > 0;
  }

  /** Diameter of hands and object together, about [m]. */
  extent() {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    const grow = (vertices, T) => {
      for (let v = 0; v < vertices.length; v += 3) {
        applied(T, vertices.subarray(v, v + 3)).forEach((x, k) => {
          low[k] = Math.min(low[k], x);
          high[k] = Math.max(high[k], x);
        });
      }
    };
    const middle = Math.floor(this.arrays.focus.shape[0] / 2);
    grow(this.at("hand_vertices", middle), IDENTITY);
    if (this.otherKnown(middle)) {
      const T_hand_cam = inverse([...this.at("T_cam_hand", middle)]);
      grow(this.at("other_hand_vertices", middle), product(T_hand_cam, [...this.at("T_cam_other_hand", middle)]));
    }
    grow(this.arrays.object_vertices, scaled(this.inHand(middle), this.arrays.scale[0]));
    return Math.hypot(...high.map((x, k) => x - low[k]));
  }

  /** The pose of the camera frame in the frame to stand in. */
  T_stand_cam() {
    const T_hand_cam = inverse([...this.at("T_cam_hand")]);
    if (this.stand === "world") return [...this.at("T_world_cam")];
    if (this.stand === "hand") return T_hand_cam;
    return this.stand === "object" ? product(inverse(this.inHand()), T_hand_cam) : IDENTITY;
  }

  /** Where to look and how the eye is turned before anybody turns it: as the image of the middle frame shows it. */
  settle() {
    const middle = Math.floor(this.arrays.focus.shape[0] / 2), { frame } = this;
    this.frame = middle;
    const T = this.T_stand_cam();
    this.frame = frame;
    this.ahead = inverse([...T.slice(0, 3), 0, ...T.slice(4, 7), 0, ...T.slice(8, 11), 0, 0, 0, 0, 1]);
    this.look = applied(T, this.at("focus", middle));
  }

  reset() {
    Object.assign(this, { pitch: 0, yaw: 0, distance: 1.9 * this.size, shift: [0, 0] });
    this.settle();
    this.ask();
  }

  standIn(frame) {
    this.stand = frame;
    this.reset();
  }

  show(frame) {
    this.frame = frame;
    this.hand.move(this.at("hand_vertices"), this.at("hand_contact"));
    if (this.other) this.other.move(this.at("other_hand_vertices"), this.at("other_hand_contact"));
    this.object.put("touch", this.at("object_contact"));
    this.ask();
  }

  ask() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  T_eye_stand() {
    const look = this.stand === "camera" ? [...this.at("focus")] : this.look;
    const back = [1, 0, 0, -look[0], 0, 1, 0, -look[1], 0, 0, 1, -look[2], 0, 0, 0, 1];
    const out = product(turn(this.pitch, this.yaw), product(this.ahead, back));
    out[3] += this.shift[0];
    out[7] += this.shift[1];
    out[11] += this.distance;
    return out;
  }

  draw() {
    const { gl, canvas, arrays, shown, places } = this;
    const width = Math.max(1, Math.round(canvas.clientWidth * devicePixelRatio));
    const height = Math.max(1, Math.round(canvas.clientHeight * devicePixelRatio));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clearColor(...SHOWN.paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const near = 0.02 * this.distance, far = 3 * this.distance + 10 * this.size;
    const [f, side] = [2.6, Math.min(width, height)];
    gl.uniformMatrix4fv(places.projection, true, [
      (f * side) / width, 0, 0, 0, 0, (-f * side) / height, 0, 0,
      0, 0, (far + near) / (far - near), (-2 * far * near) / (far - near), 0, 0, 1, 0,
    ]);
    const T_eye_cam = product(this.T_eye_stand(), this.T_stand_cam());
    const T_eye_hand = product(T_eye_cam, [...this.at("T_cam_hand")]);
    const coloured = shown.contact && this.candidate === 0;
    if (shown.hand) this.part(this.hand, T_eye_hand, SHOWN.hand, { coloured });
    if (shown.hand && this.otherKnown()) {
      this.part(this.other, product(T_eye_cam, [...this.at("T_cam_other_hand")]), SHOWN.hand, { coloured });
    }
    const scale = arrays.scale[this.candidate];
    if (shown.object) this.part(this.object, scaled(product(T_eye_hand, this.inHand()), scale), SHOWN.object, { coloured });
    if (shown.axis && this.axis && this.candidate === 0) {
      gl.depthFunc(gl.GREATER);  // where something is in front of it
      gl.depthMask(false);
      this.part(this.axis, T_eye_hand, SHOWN.hidden, { opacity: 0.55, lit: 0 });
      gl.depthFunc(gl.LESS);
      gl.depthMask(true);
      this.part(this.axis, T_eye_hand, SHOWN.axis);
    }
    if (shown.truth && arrays.true_T_cam_obj) {
      const T = scaled(product(T_eye_cam, [...this.at("true_T_cam_obj")]), arrays.true_scale[0]);
      gl.colorMask(false, false, false, false);  // depth first, or one would look through it into itself
      this.part(this.object, T, SHOWN.truth);
      gl.colorMask(true, true, true, true);
      gl.depthFunc(gl.EQUAL);
      this.part(this.object, T, SHOWN.truth, { opacity: 0.55 });
      gl.depthFunc(gl.LESS);
    }
  }

  part(surface, T_eye_mesh, colour, { opacity = 1, lit = 1, coloured = false } = {}) {
    const { gl, places } = this;
    gl.uniformMatrix4fv(places.T_eye_mesh, true, T_eye_mesh);
    gl.uniform3fv(places.colour, colour);
    gl.uniform3fv(places.contact, SHOWN.contact);
    gl.uniform1f(places.opacity, opacity);
    gl.uniform1f(places.lit, lit);
    gl.uniform1f(places.coloured, coloured ? 1 : 0);
    surface.draw();
  }

  listen() {
    const { canvas } = this, pointers = new Map();
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
        this.zoom(apart(...before) / apart(event.clientX, event.clientY));
      } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) {
        const metres = this.distance / (2.6 * 0.5 * Math.min(canvas.clientWidth, canvas.clientHeight));
        this.shift = [this.shift[0] + dx * metres, this.shift[1] + dy * metres];
      } else {
        this.yaw += 0.008 * dx;
        this.pitch = Math.max(-1.57, Math.min(1.57, this.pitch - 0.008 * dy));
      }
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      this.ask();
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(0.001 * event.deltaY));
    }, { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", () => this.reset());
  }

  zoom(factor) {
    this.distance = Math.max(0.3 * this.size, Math.min(20 * this.size, factor * this.distance));
    this.ask();
  }
}
