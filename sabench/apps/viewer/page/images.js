// Images of the cameras with projected particles and bubbles. Projections are polynomials, fitted to the camera's own to 0.001 px.
class Images {
  constructor(objects, arrays) {
    this.objects = objects;
    this.arrays = arrays;
    const { columns, rows } = data.rig.cameras[0];
    this.picture = new Picture("Image of a camera", [columns, rows], () => this.marks(), () => this.outlines());
    this.text = make("p", {});
    this.known = new Map();
    listeners.push(what => { if (what.has("camera") || what.has("kinds") || what.has("frame") || what.has("round")) this.draw(); });
  }

  card() {
    const options = data.rig.cameras.map((one, number) => make("option", { value: number, selected: number === state.camera }, one.name));
    this.select = make("select", { "aria-label": "Camera", change: event => this.choose(+event.target.value) }, options);
    this.draw();
    return make("section", { class: "card picture", id: "images" },
      make("div", { class: "bar" }, make("h2", {}, "Camera"), this.select,
        [["‹", "previous camera", -1], ["›", "next camera", 1]].map(([text, title, step]) => make("button", { type: "button", "aria-label": title, click: () => this.choose((state.camera + step + options.length) % options.length) }, text)),
        this.picture.buttons),
      this.picture.canvas, this.text);
  }

  choose(number) {
    state.camera = number;
    this.select.value = number;
    const { columns, rows } = data.rig.cameras[number];
    this.picture.size = [columns, rows];
    changed("camera");
  }

  project(point) {
    const { middle, half, powers, coefficients } = data.maps[state.camera];
    const at = point.map((value, axis) => (value - middle[axis]) / half[axis]), raised = at.map(value => [1, value]);
    let column = 0, row = 0;
    for (let term = 0; term < powers.length; term++) {
      let value = 1;
      for (let axis = 0; axis < 3; axis++) {
        const own = raised[axis], power = powers[term][axis];
        while (own.length <= power) own.push(own[own.length - 1] * at[axis]);
        value *= own[power];
      }
      column += value * coefficients[term][0];
      row += value * coefficients[term][1];
    }
    // (0, 0) is the centre of the first pixel; beyond the box of the fit, nothing is known
    return [column + .5, row + .5, at.every(value => Math.abs(value) <= 1)];
  }

  // Pixels of all particles of the frame in the camera, NaN where there are none.
  pixels(cloud) {
    const key = `${state.camera} ${state.frame}`;
    if (!this.known.has(key)) {
      if (this.known.size > 8) this.known.clear();
      const levels = this.arrays[cloud.position], pixels = new Float32Array(2 * cloud.count).fill(NaN);
      for (let row = 0; row < cloud.count; row++) {
        const [x, y, inside] = this.project(this.objects.point(levels, row));
        if (inside) { pixels[2 * row] = x; pixels[2 * row + 1] = y; }
      }
      this.known.set(key, pixels);
    }
    return this.known.get(key);
  }

  *marks() {
    const cloud = this.objects.frame?.particles;
    if (!cloud?.count || !data.maps[state.camera]) return;
    const kinds = this.arrays[cloud.kind], pixels = this.pixels(cloud);
    for (let row = 0; row < kinds.length; row++) {
      const kind = KINDS[kinds[row]];
      if (state.kinds[kind] && pixels[2 * row] === pixels[2 * row]) yield [kind, pixels[2 * row], pixels[2 * row + 1]];
    }
  }

  *outlines() {
    if (!data.maps[state.camera]) return;
    const paths = data.rig.cameras[state.camera].paths.filter(path => path[0][0] !== null);
    if (!paths.length) return;
    const ends = paths.map(path => unit(path[path.length - 1].map((value, axis) => value - path[path.length - 2][axis])));
    const along = unit([0, 1, 2].map(axis => ends.reduce((sum, one) => sum + one[axis], 0)));
    for (const [kind, centre, m] of bubblesOf(this.objects.frame, this.arrays)) {
      const points = rim(centre, m, along).map(point => this.project(point));
      if (points.every(one => one[2])) yield [kind, points];
    }
  }

  draw() {
    const frame = data.frames[state.frame], own = frame ? data.pictures[frame.number] : null, name = data.rig.cameras[state.camera].name;
    const parts = [own ? `Frame ${frame.number}` : frame ? `The image of frame ${frame.number} is not on this page` : "A rig has no images: see a data set"];
    if (!data.maps[state.camera]) parts.push(`${name} has no light path to all of the volume: nothing is projected`);
    this.text.textContent = `${parts.join(". ")}.`;
    this.picture.show(own ? own[state.camera] : null);
  }
}
