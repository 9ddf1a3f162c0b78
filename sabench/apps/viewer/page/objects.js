// Particles, their trajectories and velocities, bubbles and bodies of the frame that is shown.
const VERTEX = `
attribute float kind;
uniform float sizes[5];
uniform vec3 tints[5];
uniform vec3 behind;
uniform float scale, least, most, near, far;
varying float vKind, vSize;
varying vec3 vTint;
void main() {
  int own = int(kind + .5);
  vec4 at = modelViewMatrix * vec4(position, 1.);
  gl_Position = projectionMatrix * at;
  float size = sizes[own];
  if (size <= 0.) gl_Position = vec4(2., 2., 2., 1.);
  vSize = clamp(scale * size / -at.z, least * size, most * size);
  gl_PointSize = vSize;
  vKind = kind;
  vTint = mix(tints[own], behind, clamp((-at.z - near) / (far - near), 0., own < 2 ? .35 : .1));  // errors fade less
}`;
const FRAGMENT = `
uniform float alone;
varying float vKind, vSize;
varying vec3 vTint;
void main() {
  if (vSize > 4.5) {
    vec2 p = 2. * gl_PointCoord - 1.;
    int own = int(vKind + .5);
    float r = length(p), d = abs(p.x) + abs(p.y), thin = 2.6 / vSize;
    bool keep = own == 0 && alone < .5 ? r < 1. && r > 1. - max(thin, .22)
      : own <= 1 ? r < .8
      : own == 2 ? d < 1. && d > 1. - max(1.3 * thin, .34)
      : own == 3 ? abs(abs(p.x) - abs(p.y)) < max(thin, .3)
      : p.y < .75 && abs(p.x) < .55 * (p.y + 1.);
    if (!keep) discard;
  }
  gl_FragColor = vec4(vTint, 1.);
}`;
const SIZES = { true: .95, found: .95, missed: 1.25, ghost: 1.15, duplicate: 1.2 };  // the errors are to be seen first
const MOST_IN_SOFTWARE = 5000;  // points that WebGL draws without a graphics card
const LEAST_PX = 1.7, MOST_PX = 15;

class Objects {
  constructor(space, rig, arrays) {
    this.space = space;
    this.rig = rig;
    this.arrays = arrays;
    this.low = data.box?.low ?? [0, 0, 0];
    this.size = data.box?.size ?? [1, 1, 1];
    this.material = this.makeMaterial();
    this.points = this.lines = this.arrows = null;
    this.round = new THREE.Group();
    this.geometries = new Map();
    this.raster = space.software && Math.max(0, ...data.frames.map(one => one.particles.count)) > MOST_IN_SOFTWARE ? new Raster(space.stage) : null;
    if (this.raster) space.after.push(() => this.drawRaster());
    space.scene.add(this.round);
    space.before.push(distance => this.scaleWith(distance));
    this.build();
    listeners.push(what => this.follow(what));
  }

  follow(what) {
    if (what.has("frame")) { this.placePoints(); this.placeRound(); }
    else if (what.has("theme") || what.has("round") || what.has("kinds")) this.placeRound();
    if (what.has("frame") || what.has("kinds") || what.has("lines") || what.has("theme")) { this.placeTails(); this.placeArrows(); }
    this.paint();
    this.space.invalidate();
  }

  build() {
    this.placePoints();
    this.placeRound();
    this.placeTails();
    this.placeArrows();
    this.paint();
  }

  makeMaterial() {
    const uniforms = Object.fromEntries(["scale", "least", "most", "near", "far", "alone"].map(name => [name, { value: 1 }]));
    uniforms.alone.value = ALONE ? 1 : 0;
    uniforms.sizes = { value: [0, 0, 0, 0, 0] };
    uniforms.tints = { value: KINDS.map(() => new THREE.Color()) };
    uniforms.behind = { value: new THREE.Color() };
    return new THREE.ShaderMaterial({ vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms });
  }

  paint() {
    const { sizes, tints, behind } = this.material.uniforms;
    KINDS.forEach((kind, number) => {
      sizes.value[number] = state.kinds[kind] ? SIZES[kind] : 0;
      tints.value[number].set(colours[kind]).convertLinearToSRGB();
    });
    behind.value.set(colours.stage).convertLinearToSRGB();
  }

  // A particle is drawn as a share of the mean distance of neighbours, within limits in pixels.
  scaleWith(distance) {
    const { scale, least, most, near, far } = this.material.uniforms, pixels = this.space.renderer.getPixelRatio();
    const count = Math.max(this.frame?.particles.count ?? 1, 1), size = this.size.reduce((a, b) => a * b, 1);
    const apart = Math.cbrt(Math.max(size, 1e-9) / count);
    const height = this.space.stage.clientHeight * pixels / (2 * Math.tan(FIELD_DEG / 2 * Math.PI / 180));
    scale.value = .3 * apart * height * state.size;
    least.value = LEAST_PX * pixels * Math.sqrt(state.size);
    most.value = MOST_PX * pixels * state.size;
    near.value = Math.max(distance - this.rig.volumeRadius, 0);
    far.value = distance + 1.5 * this.rig.volumeRadius;
  }

  get frame() {
    return data.frames[state.frame];
  }

  placePoints() {
    if (this.points) this.space.scene.remove(this.points);
    this.points = null;
    if (!this.frame?.particles.count) return;
    if (!this.geometries.has(state.frame)) this.geometries.set(state.frame, this.geometryOf(this.frame.particles));
    this.points = new THREE.Points(this.geometries.get(state.frame), this.material);
    this.points.position.set(...this.low);
    this.points.scale.set(...this.size);
    this.points.visible = !this.raster;
    this.points.frustumCulled = false;
    this.space.scene.add(this.points);
  }

  drawRaster() {
    if (!this.points) { this.raster.clear(); return; }
    this.points.updateMatrixWorld();
    const { camera, stage } = this.space, cloud = this.frame.particles, ratio = this.space.renderer.getPixelRatio();
    const matrix = new THREE.Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).multiply(this.points.matrixWorld);
    this.raster.draw(this.arrays[cloud.position], this.arrays[cloud.kind], matrix, this.material.uniforms, Math.round(ratio * stage.clientWidth), Math.round(ratio * stage.clientHeight));
    this.raster.drawLabels(this.rig.sprites, camera, ratio);
  }

  geometryOf(cloud) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(this.arrays[cloud.position], 3, true));
    geometry.setAttribute("kind", new THREE.BufferAttribute(this.arrays[cloud.kind], 1));
    return geometry;
  }

  point(levels, row) {
    return [0, 1, 2].map(axis => this.low[axis] + levels[3 * row + axis] / 65535 * this.size[axis]);
  }

  replaceLines(name, points, tints) {
    if (this[name]) { this.space.scene.remove(this[name]); this[name].geometry.dispose(); }
    this[name] = null;
    if (!points.length) return;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(Float32Array.from(points), 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(Float32Array.from(tints), 3));
    this[name] = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ vertexColors: true }));
    this[name].frustumCulled = false;
    this.space.scene.add(this[name]);
  }

  speedTint(cloud, row) {
    const own = this.arrays[cloud.velocity].subarray(3 * row, 3 * row + 3);
    return new THREE.Color(...ramp(own[0] === UNKNOWN ? 0 : Math.hypot(...own) / 32767 * data.fastest / data.usual)).convertSRGBToLinear();
  }

  // Paths of the shown particles over the frames before, in the colour of their kind; the truth alone by speed.
  placeTails() {
    const points = [], tints = [], tint = KINDS.map(kind => new THREE.Color(colours[kind])), fade = new THREE.Color(colours.stage);
    const own = state.tail && this.frame?.particles.count ? this.arrays[this.frame.particles.kind] : [];
    for (let row = 0; row < own.length; row++) {
      if (!state.kinds[KINDS[own[row]]]) continue;
      let at = row, frame = state.frame;
      for (let step = 0; step < state.tail && frame > 0; step++, frame--) {
        const cloud = data.frames[frame].particles, before = this.arrays[cloud.before][at];
        if (before < 0) break;
        points.push(...this.point(this.arrays[cloud.position], at), ...this.point(this.arrays[data.frames[frame - 1].particles.position], before));
        const bright = ALONE ? this.speedTint(cloud, at) : tint[own[row]];
        for (const age of [step, step + 1]) tints.push(...bright.clone().lerp(fade, .75 * age / state.tail).toArray());
        at = before;
      }
    }
    this.replaceLines("lines", points, tints);
  }

  // Velocities as lines from the particle on, coloured by speed.
  placeArrows() {
    const points = [], tints = [];
    if (state.vectors && this.frame) {
      this.addArrows(this.frame.particles, row => this.point(this.arrays[this.frame.particles.position], row), kind => state.kinds[kind], points, tints);
      const round = this.arrays[this.frame.bubbles.position];
      if (state.bubbles) this.addArrows(this.frame.bubbles, row => [...round.subarray(3 * row, 3 * row + 3)], kind => state.kinds[kind], points, tints);
    }
    this.replaceLines("arrows", points, tints);
  }

  addArrows(cloud, at, shown, points, tints) {
    const kinds = this.arrays[cloud.kind], velocity = this.arrays[cloud.velocity];
    for (let row = 0; row < cloud.count; row++) {
      const own = velocity.subarray(3 * row, 3 * row + 3);
      if (own[0] === UNKNOWN || !shown(KINDS[kinds[row]])) continue;
      const start = at(row), tint = this.speedTint(cloud, row).toArray();
      points.push(...start, ...start.map((value, axis) => value + own[axis] / 32767 * data.fastest * state.vectors));
      tints.push(...tint, ...tint);
    }
  }

  placeRound() {
    dispose(this.round);
    const frame = this.frame;
    if (!frame) return;
    if (state.bubbles && frame.bubbles.count) this.addBubbles(frame.bubbles);
    if (state.solids) frame.solids.forEach(solid => this.addSolid(solid));
  }

  // Found bubbles are smooth, missed ones nets, ghosts faceted, true ones see-through.
  addBubbles(cloud) {
    const kinds = this.arrays[cloud.kind], at = this.arrays[cloud.position], shape = this.arrays[cloud.shape];
    const fine = cloud.count < 400 ? [32, 20] : cloud.count < 3000 ? [16, 10] : [10, 7];
    KINDS.forEach((kind, number) => {
      const rows = [...kinds.keys()].filter(row => kinds[row] === number);
      if (!rows.length || !state.kinds[kind]) return;
      const geometry = kind === "ghost" ? new THREE.IcosahedronGeometry(1, 1) : new THREE.SphereGeometry(1, ...(kind === "missed" ? [12, 8] : fine));
      const clear = kind === "true" && !ALONE;
      const material = new THREE.MeshLambertMaterial({ color: colours[kind], wireframe: kind === "missed", flatShading: kind === "ghost", transparent: clear, opacity: clear ? .25 : 1, depthWrite: !clear });
      const mesh = new THREE.InstancedMesh(geometry, material, rows.length);
      rows.forEach((row, place) => {
        const m = shape.subarray(9 * row, 9 * row + 9), p = at.subarray(3 * row, 3 * row + 3);
        mesh.setMatrixAt(place, new THREE.Matrix4().set(m[0], m[1], m[2], p[0], m[3], m[4], m[5], p[1], m[6], m[7], m[8], p[2], 0, 0, 0, 1));
      });
      mesh.frustumCulled = false;
      mesh.userData.kind = kind;
      this.round.add(mesh);
    });
  }

  addSolid(solid) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(this.arrays[solid.vertices], 3));
    geometry.setIndex(new THREE.BufferAttribute(this.arrays[solid.faces], 1));
    geometry.computeVertexNormals();
    this.round.add(new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color: colours.solid, side: THREE.DoubleSide })));
  }
}
