// A picture with marks that can be zoomed and moved; and the stacks of planes.
const MOST_MARKS = 6000;  // that are drawn with their shapes; more become dots
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

class Picture {
  // `marks` yields [kind, column, row] and `outlines` [kind, points], in pixels of a picture of `size` [columns, rows].
  constructor(name, size, marks, outlines) {
    this.size = size;
    this.marks = marks;
    this.outlines = outlines;
    this.image = null;
    this.zoom = 1;
    this.middle = [.5, .5];
    this.canvas = make("canvas", { tabindex: "0", role: "img", "aria-label": `${name}. Plus and minus zoom, arrow keys move, 0 shows all.`, keydown: event => this.key(event), wheel: event => this.wheel(event), pointerdown: event => this.grab(event) });
    this.context = this.canvas.getContext("2d");
    this.buttons = [["+", "zoom in", () => this.scale(1.6)], ["−", "zoom out", () => this.scale(1 / 1.6)], ["all", "show all", () => this.scale(0)]]
      .map(([text, title, act]) => make("button", { type: "button", "aria-label": `${title}: ${name}`, click: act }, text));
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  async show(url) {
    this.url = url;
    if (!url) { this.image = null; this.draw(); return; }
    const image = new Image();
    image.src = url;
    await image.decode();
    if (this.url === url) { this.image = image; this.draw(); }
  }

  scale(factor) {
    this.zoom = factor ? Math.min(Math.max(this.zoom * factor, 1), 40) : 1;
    if (this.zoom === 1) this.middle = [.5, .5];
    this.draw();
  }

  key(event) {
    if (event.key === "+" || event.key === "=") this.scale(1.4);
    else if (event.key === "-") this.scale(1 / 1.4);
    else if (event.key === "0") this.scale(0);
    else if (KEYS[event.key]) this.move(...KEYS[event.key].map(step => .15 * step / this.zoom));
    else return;
    event.preventDefault();
  }

  wheel(event) {
    if (document.activeElement !== this.canvas && !event.ctrlKey) return;  // the page scrolls on
    event.preventDefault();
    this.scale(event.deltaY < 0 ? 1.25 : .8);
  }

  grab(event) {
    this.canvas.focus();
    if (this.zoom === 1) return;
    this.canvas.setPointerCapture(event.pointerId);
    const box = this.canvas.getBoundingClientRect();
    this.canvas.onpointermove = step => this.move(-step.movementX / box.width / this.zoom, -step.movementY / box.height / this.zoom);
    this.canvas.onpointerup = this.canvas.onpointercancel = () => { this.canvas.onpointermove = null; };
  }

  move(right, down) {
    const half = .5 / this.zoom;
    this.middle = this.middle.map((value, i) => Math.min(Math.max(value + [right, down][i], half), 1 - half));
    this.draw();
  }

  draw() {
    const ratio = Math.min(devicePixelRatio, 2), width = Math.round(this.canvas.clientWidth * ratio);
    if (!width) return;
    const height = Math.round(width * this.size[1] / this.size[0]), own = this.context;
    if (this.canvas.width !== width || this.canvas.height !== height) { this.canvas.width = width; this.canvas.height = height; }
    this.canvas.style.touchAction = this.zoom > 1 ? "none" : "auto";
    const half = .5 / this.zoom;
    this.middle = this.middle.map(value => Math.min(Math.max(value, half), 1 - half));
    const scale = width * this.zoom / this.size[0], left = width / 2 - this.middle[0] * width * this.zoom, top = height / 2 - this.middle[1] * height * this.zoom;
    own.fillStyle = "#000";
    own.fillRect(0, 0, width, height);
    own.imageSmoothingEnabled = scale * this.size[0] / (this.image?.width ?? 1) < 3;
    if (this.image) own.drawImage(this.image, left, top, width * this.zoom, height * this.zoom);
    this.drawMarks(scale, left, top, ratio);
  }

  drawMarks(scale, left, top, ratio) {
    const own = this.context, seen = Object.fromEntries(KINDS.map(kind => [kind, []])), { width, height } = this.canvas;
    let count = 0;
    for (const [kind, column, row] of this.marks()) {
      const x = left + column * scale, y = top + row * scale;
      if (x < -9 || y < -9 || x > width + 9 || y > height + 9) continue;
      seen[kind].push(x, y);
      count++;
    }
    const radius = Math.min(Math.max(2.4 * scale, 3.2 * ratio), 11 * ratio);
    own.lineWidth = Math.max(1.2, radius * .22);
    for (const kind of KINDS) {
      own.strokeStyle = own.fillStyle = onPicture(kind);
      const at = seen[kind];
      if (count > MOST_MARKS) for (let i = 0; i < at.length; i += 2) own.fillRect(at[i] - ratio, at[i + 1] - ratio, 2 * ratio, 2 * ratio);
      else {
        own.beginPath();
        for (let i = 0; i < at.length; i += 2) markPath(own, kind, at[i], at[i + 1], radius);
        own.stroke();
      }
    }
    own.lineWidth = 1.6 * ratio;
    for (const [kind, points] of this.outlines()) {
      own.strokeStyle = onPicture(kind);
      own.beginPath();
      points.forEach(([column, row]) => own.lineTo(left + column * scale, top + row * scale));
      own.closePath();
      own.stroke();
    }
  }
}

// Colour of marks on pictures, which do not change with the theme: they are dark, or bright before a backlight.
const onPicture = kind => kind === "true" ? (data.backlit ? "#4d5661" : "#d7dde3") : colours[kind];

// Bubbles of a frame: [kind, centre, matrix].
function* bubblesOf(frame, arrays) {
  const cloud = frame?.bubbles;
  if (!cloud?.count || !state.bubbles) return;
  const kinds = arrays[cloud.kind], at = arrays[cloud.position], shape = arrays[cloud.shape];
  for (let row = 0; row < cloud.count; row++) {
    const kind = KINDS[kinds[row]];
    if (state.kinds[kind]) yield [kind, at.subarray(3 * row, 3 * row + 3), shape.subarray(9 * row, 9 * row + 9)];
  }
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => a.map(value => value / Math.hypot(...a));

// Points of an ellipsoid's rim as seen along a direction: M u for unit vectors u at right angles to the inverse of M times it.
function rim(centre, m, along) {
  const columns = [0, 1, 2].map(i => [m[i], m[3 + i], m[6 + i]]);
  const pole = unit(columns.map(one => dot(one, along) / dot(one, one)));
  const first = unit(cross(pole, Math.abs(pole[0]) < .9 ? [1, 0, 0] : [0, 1, 0])), second = cross(pole, first);
  return Array.from({ length: 28 }, (_, i) => {
    const u = [0, 1, 2].map(k => Math.cos(i * Math.PI / 14) * first[k] + Math.sin(i * Math.PI / 14) * second[k]);
    return [0, 1, 2].map(k => centre[k] + m[3 * k] * u[0] + m[3 * k + 1] * u[1] + m[3 * k + 2] * u[2]);
  });
}

class Planes {
  constructor(space, objects, arrays) {
    this.space = space;
    this.objects = objects;
    this.arrays = arrays;
    this.mesh = null;
    state.plane = Math.floor(this.stack.planes.length / 2);
    this.picture = new Picture("Plane through the volume", this.shape, () => this.marks(), () => this.outlines());
    this.text = make("p", { "aria-live": "off" });
    listeners.push(what => { if (what.has("plane") || what.has("kinds") || what.has("frame")) this.draw(); });
  }

  get stack() {
    return data.stacks[state.stack];
  }

  get shape() {
    const { across, down } = this.stack;
    return [Math.hypot(...across), Math.hypot(...down)];
  }

  card() {
    const choice = data.stacks.length > 1 ? make("select", { "aria-label": "Stack of planes", change: event => this.choose(+event.target.value) },
      data.stacks.map((one, number) => make("option", { value: number }, one.name))) : null;
    this.slider = this.makeSlider();
    const inSpace = this.space ? tick("show in space", state.slice, on => { state.slice = on; changed("plane"); }) : null;
    this.draw();
    return make("section", { class: "card picture", id: "planes" },
      make("div", { class: "bar" }, make("h2", {}, data.stacks.length > 1 ? "Planes" : "Refocused planes"), choice, this.picture.buttons),
      this.picture.canvas, this.slider, inSpace, this.text);
  }

  makeSlider() {
    return slide("plane", { least: 0, most: this.stack.planes.length - 1, step: 1, value: state.plane, show: value => `${value + 1} / ${this.stack.planes.length}` },
      value => { state.plane = value; changed("plane"); });
  }

  choose(number) {
    state.stack = number;
    state.plane = Math.min(state.plane, this.stack.planes.length - 1);
    this.picture.size = this.shape;
    const own = this.makeSlider();
    this.slider.replaceWith(own);
    this.slider = own;
    changed("plane");
  }

  // A point in the plane's pixels (mm) and its distance, in planes.
  onPlane(point) {
    const { corner, across, down, step } = this.stack, off = point.map((value, axis) => value - corner[axis]);
    return [dot(off, across) / Math.hypot(...across), dot(off, down) / Math.hypot(...down), dot(off, step) / dot(step, step) - state.plane];
  }

  *marks() {
    const cloud = this.objects.frame?.particles;
    if (state.frame !== 0 || !cloud?.count) return;
    const kinds = this.arrays[cloud.kind], levels = this.arrays[cloud.position];
    for (let row = 0; row < kinds.length; row++) {
      const kind = KINDS[kinds[row]];
      if (!state.kinds[kind]) continue;
      const [u, v, off] = this.onPlane(this.objects.point(levels, row));
      if (Math.abs(off) <= .5) yield [kind, u, v];
    }
  }

  // Cuts of bubbles by the plane, as circles of their mean half widths in it.
  *outlines() {
    if (state.frame !== 0) return;
    const { step } = this.stack, along = unit(step), apart = Math.hypot(...step);
    for (const [kind, centre, m] of bubblesOf(this.objects.frame, this.arrays)) {
      const depth = Math.hypot(...[0, 1, 2].map(i => m[i] * along[0] + m[3 + i] * along[1] + m[6 + i] * along[2]));
      const off = this.onPlane([...centre])[2] * apart / depth;
      if (Math.abs(off) < 1) yield [kind, rim(centre, m.map(value => value * Math.sqrt(1 - off * off)), along).map(point => this.onPlane(point))];
    }
  }

  draw() {
    const { corner, step, planes, name } = this.stack, place = corner.map((value, axis) => value + step[axis] * state.plane);
    const axis = step.map(Math.abs).indexOf(Math.max(...step.map(Math.abs)));
    const marked = data.frames[0].particles.count ? "; marked: particles within half a plane's distance" : "";
    this.text.textContent = `${name} of frame ${data.frames[0].number} at ${"xyz"[axis]} = ${place[axis].toFixed(3)} mm${state.frame === 0 ? marked : "; marks are of frame 0 only"}.`;
    this.picture.show(planes[state.plane]);
    if (this.space) this.drawInSpace(place);
  }

  async drawInSpace(place) {
    if (this.mesh) { this.space.scene.remove(this.mesh); dispose(this.mesh); this.mesh = null; this.space.invalidate(); }
    const url = this.stack.planes[state.plane];
    if (!state.slice) return;
    const image = new Image();
    image.src = url;
    await image.decode();
    if (this.mesh || !state.slice || url !== this.stack.planes[state.plane]) return;
    const { across, down } = this.stack, texture = new THREE.Texture(image);
    texture.colorSpace = THREE.SRGBColorSpace;
    texture.needsUpdate = true;
    const mesh = new THREE.Mesh(new THREE.PlaneGeometry(Math.hypot(...across), Math.hypot(...down)), new THREE.MeshBasicMaterial({ map: texture, side: THREE.DoubleSide, transparent: true, opacity: .92 }));
    const axes = [unit(across), unit(down).map(value => -value)].map(vector);
    mesh.applyMatrix4(new THREE.Matrix4().makeBasis(...axes, axes[0].clone().cross(axes[1])).setPosition(...place.map((value, axis) => value + (across[axis] + down[axis]) / 2)));
    this.mesh = mesh;
    this.space.scene.add(mesh);
    this.space.invalidate();
  }
}
