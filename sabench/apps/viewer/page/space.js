// The drawing in space: camera, presets and drawing on demand.
const UP = new THREE.Vector3(0, -1, 0);  // the world's y points down
const FIELD_DEG = 35;
const CALM_MS = 180;  // after the last movement
const MOVING = { ratio: .5, least: .3, step: .85 };  // pixels of the drawing for one of the screen, along each side
const SLOW_MS = 34, FRAMES = 8;  // between drawings, in the mean of so many
const vector = values => new THREE.Vector3(...values);

class Space {
  constructor(stage) {
    this.stage = stage;
    this.canvas = make("canvas", { tabindex: "0", role: "img", "aria-label": "Drawing in space. Arrow keys turn it, plus and minus zoom, 0 shows all.", keydown: event => this.key(event) });
    this.software = drawsInSoftware();
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: !this.software, powerPreference: "high-performance" });
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(FIELD_DEG, 1, 1, 1000);
    this.camera.up.copy(UP);
    this.sky = new THREE.HemisphereLight(0xffffff, 0x8890a0, 2.2);
    this.lamp = new THREE.DirectionalLight(0xffffff, 1.6);
    this.camera.add(this.lamp);
    this.lamp.position.set(-1, 1, 1.5);
    this.scene.add(this.sky, this.camera);
    stage.prepend(this.canvas);
    this.controls = new THREE.OrbitControls(this.camera, this.canvas);
    this.controls.addEventListener("change", () => (this.software ? this.hurry() : this.invalidate()));
    this.before = [];  // called before each drawing
    this.after = [];
    this.hurried = null;  // the timer of the next drawing of all pixels
    this.moving = MOVING.ratio;
    this.asked = false;
    new ResizeObserver(() => this.resize()).observe(stage);
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.stage;
    if (!width || !height) return;
    this.renderer.setPixelRatio(this.software ? 1 : Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.invalidate();
  }

  invalidate() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => this.draw());
  }

  // While the drawing moves in software, it has half as many pixels along each side, or fewer where that is slow.
  hurry() {
    if (this.hurried === null) { this.setRatio(this.moving); this.drawn = []; }
    clearTimeout(this.hurried);
    this.hurried = setTimeout(() => { this.hurried = null; this.setRatio(1); this.invalidate(); }, CALM_MS);
    this.invalidate();
  }

  keepPace() {
    const { drawn } = this;
    if (drawn.push(performance.now()) <= FRAMES) return;
    this.drawn = [];
    if (drawn.at(-1) - drawn[0] < FRAMES * SLOW_MS || this.moving <= MOVING.least) return;
    this.moving = Math.max(MOVING.least, MOVING.step * this.moving);
    this.setRatio(this.moving);
  }

  setRatio(ratio) {
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(this.stage.clientWidth, this.stage.clientHeight, false);
  }

  draw() {
    this.asked = false;
    if (this.hurried !== null) this.keepPace();
    const distance = this.camera.position.distanceTo(this.controls.target);
    this.camera.near = distance / 200;
    this.camera.far = distance + 4 * this.radius;
    this.camera.updateProjectionMatrix();
    for (const act of this.before) act(distance);
    this.renderer.setClearColor(colours.stage);
    this.renderer.render(this.scene, this.camera);
    for (const act of this.after) act();
  }

  // Look at points from a direction, as near as all of them are in view.
  look(points, from) {
    const back = from.clone().normalize(), right = new THREE.Vector3().crossVectors(UP, back).normalize(), up = new THREE.Vector3().crossVectors(back, right);
    const tall = .86 * Math.tan(FIELD_DEG / 2 * Math.PI / 180), wide = tall * this.camera.aspect;
    let low = [Infinity, Infinity], high = [-Infinity, -Infinity], distance = 0;
    const target = points.reduce((sum, one) => sum.add(one), new THREE.Vector3()).multiplyScalar(1 / points.length);
    for (let turn = 0; turn < 3; turn++) {  // the middle of what is seen depends on the distance, and the other way round
      distance = Math.max(...points.map(one => one.clone().sub(target)).map(off => off.dot(back) + Math.max(Math.abs(off.dot(right)) / wide, Math.abs(off.dot(up)) / tall)));
      low = [Infinity, Infinity];
      high = [-Infinity, -Infinity];
      for (const one of points) {
        const off = one.clone().sub(target), ahead = distance - off.dot(back);
        [right, up].forEach((axis, i) => { low[i] = Math.min(low[i], off.dot(axis) / ahead); high[i] = Math.max(high[i], off.dot(axis) / ahead); });
      }
      target.addScaledVector(right, (low[0] + high[0]) / 2 * distance).addScaledVector(up, (low[1] + high[1]) / 2 * distance);
    }
    this.controls.target.copy(target);
    this.camera.position.copy(target).addScaledVector(back, 1.04 * distance);
    this.controls.update();
    this.invalidate();
  }

  key(event) {
    const turn = .12, offset = this.camera.position.clone().sub(this.controls.target);
    const side = new THREE.Vector3().crossVectors(this.camera.up, offset).normalize();
    const acts = {
      ArrowLeft: () => offset.applyAxisAngle(this.camera.up, turn), ArrowRight: () => offset.applyAxisAngle(this.camera.up, -turn),
      ArrowUp: () => this.tilt(offset, side, turn), ArrowDown: () => this.tilt(offset, side, -turn),
      "+": () => offset.multiplyScalar(.85), "=": () => offset.multiplyScalar(.85), "-": () => offset.multiplyScalar(1 / .85),
    };
    if (event.key === "0") this.home();
    else if (acts[event.key]) {
      acts[event.key]();
      this.camera.position.copy(this.controls.target).add(offset);
      this.controls.update();
    } else return;
    event.preventDefault();
    this.invalidate();
  }

  tilt(offset, side, angle) {
    const now = offset.angleTo(this.camera.up);
    if ((angle > 0 && now > .15) || (angle < 0 && now < Math.PI - .15)) offset.applyAxisAngle(side, -angle);
  }
}

function dispose(group) {
  group.traverse(object => { object.geometry?.dispose(); object.material?.map?.dispose(); object.material?.dispose?.(); });
  group.clear();
}

// Line segments between pairs of points.
function segments(points, colour, opacity = 1) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(Float32Array.from(points), 3));
  return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: colour, transparent: opacity < 1, opacity, depthWrite: opacity >= 1 }));
}

// A translucent sheet of no thickness, seen from both sides.
function surface(geometry, colour, opacity) {
  return new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity, side: THREE.DoubleSide, forceSinglePass: true, depthWrite: false }));
}

// A translucent box, by its far faces alone: one layer of pixels, from outside and from within.
function solid(geometry, colour, opacity) {
  return new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity, side: THREE.BackSide, depthWrite: false }));
}

// Text that faces the viewer, of a height in pixels of the screen.
function label(text, colour, pixels = 13) {
  const canvas = make("canvas"), context = canvas.getContext("2d"), font = "600 40px system-ui, sans-serif";
  context.font = font;
  canvas.width = Math.ceil(context.measureText(text).width) + 16;
  canvas.height = 56;
  const own = canvas.getContext("2d");
  own.font = font;
  own.textBaseline = "middle";
  own.lineWidth = 10;
  own.lineJoin = "round";
  own.strokeStyle = colours.stage;
  own.strokeText(text, 8, 29);
  own.fillStyle = colour;
  own.fillText(text, 8, 29);
  const texture = new THREE.CanvasTexture(canvas);
  texture.colorSpace = THREE.SRGBColorSpace;
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map: texture, depthTest: false, sizeAttenuation: false, transparent: true }));
  sprite.userData = { ratio: canvas.width / canvas.height, pixels: pixels * 1.35 };
  sprite.renderOrder = 10;
  return sprite;
}
