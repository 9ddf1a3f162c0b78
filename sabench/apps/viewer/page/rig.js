// Cameras, frusta, walls, light and volume.
const MOST_LABELS = 30;  // names of cameras in space
const MOST_SMALL_PX = 170;  // of a volume without lengths at its edges

function boxEdges(low, high) {
  const points = [], ends = [low, high];
  for (let axis = 0; axis < 3; axis++)
    for (let a = 0; a < 2; a++)
      for (let b = 0; b < 2; b++)
        for (let end = 0; end < 2; end++) {
          const point = [];
          point[axis] = ends[end][axis];
          point[(axis + 1) % 3] = ends[a][(axis + 1) % 3];
          point[(axis + 2) % 3] = ends[b][(axis + 2) % 3];
          points.push(...point);
        }
  return points;
}

// Pairs of points along the light paths of a camera's image: its corners or all, and loops where they bend and end.
function frustumLines(camera, every) {
  const lines = [], paths = camera.paths, there = path => path[0][0] !== null;
  paths.forEach((path, number) => {
    if (!there(path) || (!every && number % data.rig.side)) return;
    for (let i = 1; i < path.length; i++) lines.push(...path[i - 1], ...path[i]);
  });
  paths.forEach((path, number) => {
    const next = paths[(number + 1) % paths.length];
    if (!there(path) || !there(next)) return;
    for (let i = 1; i < path.length; i++) lines.push(...path[i], ...next[i]);
  });
  return lines;
}

class Rig {
  constructor(space) {
    this.space = space;
    this.group = new THREE.Group();
    space.scene.add(this.group);
    const [low, high] = data.rig.volume;
    this.low = vector(low);
    this.high = vector(high);
    this.middle = this.low.clone().add(this.high).multiplyScalar(.5);
    this.volumeRadius = this.low.distanceTo(this.high) / 2;
    this.centers = data.rig.cameras.map(one => vector(one.center));
    const bounds = [...this.centers, this.low, this.high];
    this.rigLow = bounds.reduce((a, b) => a.clone().min(b));
    this.rigHigh = bounds.reduce((a, b) => a.clone().max(b));
    this.rigRadius = this.rigLow.distanceTo(this.rigHigh) / 2 * 1.08;
    this.corners = [0, 1, 2, 3, 4, 5, 6, 7].map(i => new THREE.Vector3(...[0, 1, 2].map(axis => data.rig.volume[i >> axis & 1][axis])));
    this.bodies = data.rig.cameras.map(one => vector(one.center).addScaledVector(vector(one.axes[2]), -.07 * this.rigRadius));
    space.radius = this.rigRadius + this.volumeRadius;
    space.before.push(distance => this.sizeLabels(distance));
    this.build();
    listeners.push(what => { if (what.has("theme") || what.has("rig") || what.has("camera")) this.build(); });
  }

  build() {
    dispose(this.group);
    this.sprites = [];
    if (state.volume) this.addVolume();
    if (state.frusta !== "none") this.addFrusta();
    if (state.cameras) this.addCameras();
    if (state.wall) data.rig.walls.forEach(wall => (wall.kind === "plane" ? this.addPlane(wall) : this.addCylinder(wall)));
    if (state.sheet && data.rig.sheet) this.addSheet(data.rig.sheet);
    if (state.sheet && data.rig.backlight) this.addPlate(data.rig.backlight);
    data.rig.discs.forEach(disc => this.addDisc(disc));
    this.space.invalidate();
  }

  addVolume() {
    const [low, high] = data.rig.volume, scored = data.rig.scored;
    this.group.add(segments(boxEdges(low, high), colours.quiet));
    if (JSON.stringify(scored) !== JSON.stringify(data.rig.volume)) this.group.add(segments(boxEdges(...scored), colours.quiet, .35));
    if (!state.labels) return;
    ["x", "y", "z"].forEach((name, axis) => {
      const at = [low[0], high[1], low[2]], beyond = .14 * this.volumeRadius;
      at[axis] = (low[axis] + high[axis]) / 2;
      if (axis === 1) { at[0] = high[0] + beyond; at[2] = low[2] - beyond; }
      else { at[1] += beyond; at[2 - axis] = low[2 - axis] - beyond; }
      this.addLabel(`${name}  ${+(high[axis] - low[axis]).toPrecision(4)} mm`, colours.text, at, 12, true);
    });
  }

  addLabel(text, colour, at, pixels, near = false) {
    const sprite = label(text, colour, pixels);
    sprite.userData.near = near;  // is left out where the volume is small on the screen
    sprite.position.set(...at);
    this.sprites.push(sprite);
    this.group.add(sprite);
  }

  sizeLabels(distance) {
    const scale = 2 * Math.tan(FIELD_DEG / 2 * Math.PI / 180) / this.space.stage.clientHeight, small = 2 * this.volumeRadius / distance / scale < MOST_SMALL_PX;
    for (const sprite of this.sprites) {
      sprite.visible = !(small && sprite.userData.near);
      const { ratio, pixels } = sprite.userData;
      sprite.scale.set(ratio * pixels * scale, pixels * scale, 1);
    }
  }

  addFrusta() {
    const others = state.frusta === "all" ? data.rig.cameras.filter((_, number) => number !== state.camera) : [];
    const faint = Math.max(.16, .5 / Math.sqrt(others.length || 1));
    this.group.add(segments(others.flatMap(one => frustumLines(one, false)), colours.rig, faint));
    this.group.add(segments(frustumLines(data.rig.cameras[state.camera], false), colours.chosen));
    const estimated = data.rig.estimated.filter((_, number) => state.frusta === "all" || number === state.camera);
    if (estimated.length) this.group.add(segments(estimated.flatMap(one => frustumLines(one, false)), colours.found, .6));
  }

  // Bodies and lenses of cameras; a symbol has a size of the rig, not of a real camera.
  addCameras() {
    this.addBodies(data.rig.cameras, number => (number === state.camera ? colours.chosen : colours.rig));
    this.addBodies(data.rig.estimated, () => colours.found);
    if (!state.labels || data.rig.cameras.length > MOST_LABELS) return;
    const size = .05 * this.rigRadius;
    data.rig.cameras.forEach((one, number) => {
      const at = vector(one.center).addScaledVector(vector(one.axes[1]), -size).addScaledVector(vector(one.axes[2]), -size);
      this.addLabel(one.name.replace(/^camera_/, ""), number === state.camera ? colours.chosen : colours.quiet, at.toArray(), 11);
    });
  }

  addBodies(cameras, colourOf) {
    const size = .045 * this.rigRadius;
    const body = new THREE.BoxGeometry(size, .7 * size, .9 * size), lens = new THREE.CylinderGeometry(.27 * size, .32 * size, .55 * size, 20);
    body.translate(0, 0, -.95 * size);
    lens.rotateX(Math.PI / 2);
    lens.translate(0, 0, -.25 * size);
    for (const geometry of [body, lens]) {
      const mesh = new THREE.InstancedMesh(geometry, new THREE.MeshLambertMaterial(), cameras.length);
      cameras.forEach((one, number) => {
        mesh.setMatrixAt(number, new THREE.Matrix4().makeBasis(...one.axes.map(vector)).setPosition(...one.center));
        mesh.setColorAt(number, new THREE.Color(colourOf(number)));
      });
      this.group.add(mesh);
    }
  }

  addPlane(wall) {
    const normal = vector(wall.normal), [first, second] = wall.axes.map(vector);
    const size = wall.high.map((high, i) => high - wall.low[i]), mean = wall.high.map((high, i) => (high + wall.low[i]) / 2);
    const at = depth => vector(wall.point).addScaledVector(first, mean[0]).addScaledVector(second, mean[1]).addScaledVector(normal, depth);
    const put = (mesh, depth) => {
      mesh.applyMatrix4(new THREE.Matrix4().makeBasis(first, second, normal).setPosition(at(depth)));
      this.group.add(mesh);
    };
    const depths = wall.depths, last = depths[depths.length - 1];
    if (last > 0) put(solid(new THREE.BoxGeometry(size[0], size[1], last), colours.glass, .18), last / 2);
    for (const depth of depths) put(this.rim(size[0], size[1]), depth);
    if (!last) put(surface(new THREE.PlaneGeometry(...size), colours.glass, .12), 0);
    if (wall.back !== null && wall.back < 4 * this.volumeRadius + last) put(this.rim(size[0], size[1]), wall.back);
  }

  rim(width, height) {
    const [x, y] = [width / 2, height / 2];
    return segments([-x, -y, 0, x, -y, 0, x, -y, 0, x, y, 0, x, y, 0, -x, y, 0, -x, y, 0, -x, -y, 0], colours.glass, .75);
  }

  addCylinder(wall) {
    const axis = vector(wall.axis), turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 1, 0), axis);
    const middle = vector(wall.point).addScaledVector(axis, (wall.low + wall.high) / 2), length = wall.high - wall.low;
    for (const radius of wall.radii) {
      const shell = surface(new THREE.CylinderGeometry(radius, radius, length, 96, 1, true), colours.glass, .09);
      const circle = Array.from({ length: 97 }, (_, i) => [radius * Math.cos(i * Math.PI / 48), radius * Math.sin(i * Math.PI / 48)]);
      const rims = [-length / 2, length / 2].flatMap(y => circle.slice(1).flatMap(([x, z], i) => [circle[i][0], y, circle[i][1], x, y, z]));
      for (const mesh of [shell, segments(rims, colours.glass, .75)]) {
        mesh.quaternion.copy(turn);
        mesh.position.copy(middle);
        this.group.add(mesh);
      }
    }
  }

  addSheet(sheet) {
    const axes = sheet.axes.map(vector), matrix = new THREE.Matrix4().makeBasis(axes[0], axes[1], axes[2]).setPosition(...sheet.center);
    const box = solid(new THREE.BoxGeometry(...sheet.size), colours.light, .08);
    const half = sheet.size.map(edge => edge / 2), edges = segments(boxEdges(half.map(edge => -edge), half), colours.light, .4);
    const arrow = sheet.size[0] * .09, x = -half[0] - 2.2 * arrow;
    const head = segments([x, 0, 0, x + 2 * arrow, 0, 0, x + 2 * arrow, 0, 0, x + 1.4 * arrow, .35 * arrow, 0, x + 2 * arrow, 0, 0, x + 1.4 * arrow, -.35 * arrow, 0], colours.light);
    for (const mesh of [box, edges, head]) { mesh.applyMatrix4(matrix); this.group.add(mesh); }
    if (state.labels) this.addLabel("light", colours.light, vector([x, 0, 0]).applyMatrix4(matrix).toArray(), 11, true);
  }

  addPlate(plate) {
    const matrix = new THREE.Matrix4().makeBasis(...plate.axes.map(vector)).setPosition(...plate.center);
    for (const mesh of [surface(new THREE.PlaneGeometry(...plate.size), colours.light, .1), this.plateRim(plate)]) { mesh.applyMatrix4(matrix); this.group.add(mesh); }
    if (state.labels) this.addLabel("backlight", colours.light, plate.center, 11);
  }

  plateRim(plate) {
    const [x, y] = plate.size.map(edge => edge / 2);
    return segments([-x, -y, 0, x, -y, 0, x, -y, 0, x, y, 0, x, y, 0, -x, y, 0, -x, y, 0, -x, -y, 0], colours.light, .7);
  }

  addDisc(disc) {
    const mesh = new THREE.Mesh(new THREE.CircleGeometry(disc.radius, 48), new THREE.MeshBasicMaterial({ color: colours.text, side: THREE.DoubleSide }));
    mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), vector(disc.normal));
    mesh.position.set(...disc.center);
    this.group.add(mesh);
  }
}
