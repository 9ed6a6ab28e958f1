// The vessel and the devices in 3-D with WebGL: a glowing translucent lumen, opaque devices, the target; drag turns it.

const VESSEL = `
attribute vec3 position, normal; uniform mat4 view, projection; varying vec3 n, p;
void main() { vec4 at = view * vec4(position, 1.0); p = at.xyz; n = mat3(view) * normal; gl_Position = projection * at; }`;
// Brighter where the wall is seen edge-on: added up, near and far walls need no sorting.
const VESSEL_INK = `
precision mediump float; varying vec3 n, p; uniform vec3 colour;
void main() { float edge = 1.0 - abs(dot(normalize(n), normalize(p))); gl_FragColor = vec4(colour * (0.07 + 0.55 * edge * edge * edge), 1.0); }`;
const SOLID = `
attribute vec3 position, normal; uniform mat4 view, projection; varying vec3 n;
void main() { n = mat3(view) * normal; gl_Position = projection * view * vec4(position, 1.0); }`;
const SOLID_INK = `
precision mediump float; varying vec3 n; uniform vec3 colour;
void main() { gl_FragColor = vec4(colour * (0.45 + 0.55 * max(0.0, normalize(n).z)), 1.0); }`;

const SIDES = 8; // of a device's tube
const SMOOTH = 3; // rings a link
const WIRE = { radius: 0.0009, colour: [0.93, 0.97, 1.0] }; // m; devices are drawn twice as thick as they are
const CATHETER = { radius: 0.0016, colour: [0.36, 0.62, 1.0] };
const SHOWN_SHEATH = 0.03; // m of a device outside the phantom's bounds that are drawn

export class Space {
  constructor(canvas) {
    this.canvas = canvas;
    this.slow = drawnBySoftware();
    this.changed = true; // since it was drawn
    const gl = (this.gl = canvas.getContext("webgl", { antialias: !this.slow, alpha: false }));
    if (!gl) throw new Error("this browser has no WebGL: the 3-D view is left out");
    if (!gl.getExtension("OES_element_index_uint")) throw new Error("this browser's WebGL is too old for the 3-D view");
    this.vessel = this.#program(VESSEL, VESSEL_INK);
    this.solid = this.#program(SOLID, SOLID_INK);
    this.surface = null;
    this.device = this.#mesh();
    this.ball = this.#mesh();
    new ResizeObserver(() => { this.changed = true; }).observe(canvas);
    this.turn = [0, 0]; // azimuth, elevation, rad; 0 is the front
    this.zoom = 1;
    this.#mouse();
  }

  setSurface(vertices, normals, faces) {
    this.surface ??= this.#mesh();
    this.#fill(this.surface, vertices, normals, faces);
    this.changed = true;
  }

  setTask({ bounds, goal, success_radius: radius }) {
    const [low, high] = bounds;
    this.bounds = bounds;
    this.centre = low.map((x, k) => (x + high[k]) / 2);
    this.size = high[2] - low[2];
    this.#fill(this.ball, ...sphere(goal, radius * 0.45));
    this.changed = true;
  }

  // Points of wire and catheter, each from its tip on; an absent device has none.
  draw(wire, catheter = []) {
    const { gl, canvas } = this;
    if (!this.centre || gl.isContextLost()) return;
    this.changed = false;
    const ratio = this.slow ? 1 : Math.min(devicePixelRatio || 1, 1.5);
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.024, 0.031, 0.043, 1);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { view, projection } = this.#camera(width / height);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    const low = this.bounds[0][2] - SHOWN_SHEATH, high = this.bounds[1][2] + SHOWN_SHEATH;
    for (const [points, { radius, colour }] of [[wire, WIRE], [catheter, CATHETER]]) {
      const shown = points.filter((p) => p[2] > low && p[2] < high);
      if (shown.length < 2) continue;
      this.#fill(this.device, ...tube(smooth(shown), radius), gl.DYNAMIC_DRAW);
      this.#paint(this.solid, this.device, view, projection, colour);
    }
    this.#paint(this.solid, this.ball, view, projection, [0.25, 0.9, 0.5]);
    if (this.surface) {
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE);
      gl.depthMask(false);
      gl.disable(gl.DEPTH_TEST);
      this.#paint(this.vessel, this.surface, view, projection, [0.95, 0.36, 0.34]);
    }
  }

  #camera(aspect) {
    const fov = 0.5, far = (0.57 * this.size) / Math.tan(fov / 2) / Math.min(1, aspect * 1.25) / this.zoom;
    const [azimuth, elevation] = this.turn;
    // the eye stands in front of the patient (-y); +x, the patient's left, is to the right, +z up
    const back = [Math.sin(azimuth) * Math.cos(elevation), -Math.cos(azimuth) * Math.cos(elevation), Math.sin(elevation)];
    const right = [Math.cos(azimuth), Math.sin(azimuth), 0];
    const up = cross(back, right);
    const eye = this.centre.map((x, k) => x + far * back[k]);
    const view = new Float32Array([
      right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
      -dot(right, eye), -dot(up, eye), -dot(back, eye), 1]);
    const f = 1 / Math.tan(fov / 2), near = 0.01, limit = 10;
    const projection = new Float32Array([
      f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (limit + near) / (near - limit), -1, 0, 0, (2 * limit * near) / (near - limit), 0]);
    return { view, projection };
  }

  #mouse() {
    const { canvas } = this;
    let from = null;
    canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", () => { from = null; });
    canvas.addEventListener("pointercancel", () => { from = null; });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      this.turn[0] -= (event.clientX - from[0]) * 0.008;
      this.turn[1] = Math.max(-1.4, Math.min(1.4, this.turn[1] + (event.clientY - from[1]) * 0.008));
      from = [event.clientX, event.clientY];
      this.changed = true;
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom = Math.max(0.5, Math.min(6, this.zoom * Math.exp(-event.deltaY * 0.001)));
      this.changed = true;
    }, { passive: false });
    canvas.addEventListener("dblclick", () => { this.turn = [0, 0]; this.zoom = 1; this.changed = true; });
  }

  #program(vertex, fragment) {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(`3-D view: ${gl.getShaderInfoLog(shader)}`);
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "position");
    gl.bindAttribLocation(program, 1, "normal");
    gl.linkProgram(program);
    const uniform = (name) => gl.getUniformLocation(program, name);
    return { program, view: uniform("view"), projection: uniform("projection"), colour: uniform("colour") };
  }

  #mesh() {
    const { gl } = this;
    return { vertices: gl.createBuffer(), normals: gl.createBuffer(), faces: gl.createBuffer(), count: 0 };
  }

  #fill(mesh, vertices, normals, faces, usage = this.gl.STATIC_DRAW) {
    const { gl } = this;
    for (const [buffer, data] of [[mesh.vertices, vertices], [mesh.normals, normals]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, usage);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.faces);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, usage);
    mesh.count = faces.length;
  }

  #paint(shader, mesh, view, projection, colour) {
    const { gl } = this;
    if (!mesh.count) return;
    gl.useProgram(shader.program);
    gl.uniformMatrix4fv(shader.view, false, view);
    gl.uniformMatrix4fv(shader.projection, false, projection);
    gl.uniform3fv(shader.colour, colour);
    for (const [slot, buffer] of [[0, mesh.vertices], [1, mesh.normals]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(slot);
      gl.vertexAttribPointer(slot, 3, gl.FLOAT, false, 0, 0);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.faces);
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0);
  }
}

// Without a graphics card the view does without smooth edges: they would cost it most of its pictures.
function drawnBySoftware() {
  const gl = document.createElement("canvas").getContext("webgl");
  const names = gl?.getExtension("WEBGL_debug_renderer_info");
  return Boolean(names) && /swiftshader|llvmpipe|software/i.test(gl.getParameter(names.UNMASKED_RENDERER_WEBGL));
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const minus = (a, b) => a.map((x, k) => x - b[k]);
const unit = (a) => { const length = Math.hypot(...a) || 1; return a.map((x) => x / length); };

// A Catmull-Rom curve through the links' ends.
function smooth(points) {
  const result = [];
  const at = (k) => points[Math.max(0, Math.min(points.length - 1, k))];
  for (let i = 0; i + 1 < points.length; i++) {
    const [a, b, c, d] = [at(i - 1), at(i), at(i + 1), at(i + 2)];
    for (let s = 0; s < SMOOTH; s++) {
      const t = s / SMOOTH;
      result.push(b.map((x, k) => x + 0.5 * t * (c[k] - a[k] + t * (2 * a[k] - 5 * x + 4 * c[k] - d[k] + t * (3 * (x - c[k]) + d[k] - a[k])))));
    }
  }
  result.push(points[points.length - 1]);
  return result;
}

function tube(points, radius) {
  const rings = points.length;
  const vertices = new Float32Array(rings * SIDES * 3), normals = new Float32Array(rings * SIDES * 3);
  const faces = new Uint32Array((rings - 1) * SIDES * 6);
  let side = null;
  for (let i = 0; i < rings; i++) {
    const along = unit(minus(points[Math.min(i + 1, rings - 1)], points[Math.max(i - 1, 0)]));
    side ??= Math.abs(along[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
    side = unit(minus(side, along.map((x) => x * dot(side, along)))); // carried along, so that the tube does not twist
    const other = cross(along, side);
    for (let j = 0; j < SIDES; j++) {
      const angle = (2 * Math.PI * j) / SIDES;
      for (let k = 0; k < 3; k++) {
        const n = Math.cos(angle) * side[k] + Math.sin(angle) * other[k];
        normals[3 * (i * SIDES + j) + k] = n;
        vertices[3 * (i * SIDES + j) + k] = points[i][k] + radius * n;
      }
      if (i + 1 < rings) {
        const a = i * SIDES + j, b = i * SIDES + ((j + 1) % SIDES);
        faces.set([a, b, a + SIDES, b, b + SIDES, a + SIDES], 6 * a);
      }
    }
  }
  return [vertices, normals, faces];
}

function sphere(centre, radius, rows = 12, columns = 18) {
  const vertices = [], normals = [], faces = [];
  for (let i = 0; i <= rows; i++) {
    for (let j = 0; j <= columns; j++) {
      const polar = (Math.PI * i) / rows, azimuth = (2 * Math.PI * j) / columns;
      const n = [Math.sin(polar) * Math.cos(azimuth), Math.sin(polar) * Math.sin(azimuth), Math.cos(polar)];
      normals.push(...n);
      vertices.push(...n.map((x, k) => centre[k] + radius * x));
      const a = i * (columns + 1) + j;
      if (i < rows && j < columns) faces.push(a, a + columns + 1, a + 1, a + 1, a + columns + 1, a + columns + 2);
    }
  }
  return [new Float32Array(vertices), new Float32Array(normals), new Uint32Array(faces)];
}
