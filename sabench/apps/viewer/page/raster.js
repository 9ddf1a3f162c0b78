// Points drawn by the page itself, for browsers that draw without a graphics card: there, a point of WebGL takes microseconds, and here tens of nanoseconds.
const LEVEL_BITS = 4, LEVELS = 1 << LEVEL_BITS;  // of the fading with distance
const TINT_BITS = 7, TINTS = (1 << TINT_BITS) - 1;  // kinds and levels
const DEPTH_BITS = 23, DEPTHS = 1 << DEPTH_BITS, NOTHING = 0x7fffffff;
const NUMBERS = ["scale", "least", "most", "near", "far"];  // of the uniforms that a batch takes
const BATCH = 10000;
const RIM = 48;  // pixels around the picture, for points on its edge

// Does this browser draw in software?
function drawsInSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2"), names = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

// Rows of pixels of a kind's shape at a size: offset down, first and last offset across.
function shapeRows(kind, size) {
  const rows = [], half = size / 2;
  for (let row = 0; row < size; row++) {
    let first = -1;
    for (let column = 0; column <= size; column++) {
      const inside = column < size && (size < 5 || inShape(kind, (column + .5) / half - 1, (row + .5) / half - 1, size));
      if (inside && first < 0) first = column;
      if (!inside && first >= 0) { rows.push(row - Math.floor(half), first - Math.floor(half), column - 1 - Math.floor(half)); first = -1; }
    }
  }
  return Int16Array.from(rows);
}

// The shapes of the fragment shader in objects.js.
function inShape(kind, x, y, size) {
  const r = Math.hypot(x, y), d = Math.abs(x) + Math.abs(y), thin = 2.6 / size;
  if (kind === 0 && !ALONE) return r < 1 && r > 1 - Math.max(thin, .22);
  if (kind <= 1) return r < .8;
  if (kind === 2) return d < 1 && d > 1 - Math.max(1.3 * thin, .34);
  if (kind === 3) return Math.abs(Math.abs(x) - Math.abs(y)) < Math.max(thin, .3);
  return y < .75 && Math.abs(x) < .55 * (y + 1);
}

// Keep each pixel's nearest point, as one number: its depth, and its place in the palette in the last bits.
// `numbers`: the matrix, width, height, NUMBERS, and the sizes of the kinds. A function of its own, called often, with numbers from arrays: a browser compiles it sooner, and to code that is twice as fast.
function placeBatch(nearest, levels, kinds, numbers, shapes, first, end) {
  const a = numbers[0], d = numbers[1], g = numbers[3], b = numbers[4], e = numbers[5], h = numbers[7], c = numbers[8], f = numbers[9], i = numbers[11], p = numbers[12], q = numbers[13], r = numbers[15];
  const width = numbers[16], height = numbers[17], scale = numbers[18], least = numbers[19], most = numbers[20], near = numbers[21], steps = (DEPTHS - 1) / (numbers[22] - near);
  const wide = width + 2 * RIM, low = RIM / 2, right = wide - low, below = height + 2 * RIM - low;
  const halfWide = .5 * width, halfHigh = .5 * height, middle = halfWide + RIM + .5, centre = halfHigh + RIM + .5;
  for (let row = first, at = 3 * first; row < end; row++, at += 3) {
    const kind = kinds[row], size = numbers[23 + kind];
    if (size === 0) continue;
    const x = levels[at], y = levels[at + 1], z = levels[at + 2], w = g * x + h * y + i * z + r;
    if (w <= 0) continue;
    const share = 1 / w, column = (middle + halfWide * share * (a * x + b * y + c * z + p)) | 0, line = (centre - halfHigh * share * (d * x + e * y + f * z + q)) | 0;
    if (column < low || line < low || column >= right || line >= below) continue;
    const own = (size * Math.max(least, Math.min(most, scale * share)) + .5) | 0;
    const depth = Math.max(0, Math.min(DEPTHS - 1, (w - near) * steps)) | 0;
    const value = depth << TINT_BITS | kind * LEVELS + (depth >> DEPTH_BITS - LEVEL_BITS), place = line * wide + column;
    if (own <= 1) {
      if (value < nearest[place]) nearest[place] = value;
      continue;
    }
    const rows = shapes[kind * (RIM + 1) + (own > RIM ? RIM : own)];
    for (let k = 0; k < rows.length; k += 3) {
      const start = place + rows[k] * wide, last = start + rows[k + 2];
      for (let one = start + rows[k + 1]; one <= last; one++)
        if (value < nearest[one]) nearest[one] = value;
    }
  }
}

class Raster {
  constructor(stage) {
    this.canvas = make("canvas", { class: "raster", "aria-hidden": "true" });
    this.context = this.canvas.getContext("2d");
    this.shapes = new Map();
    stage.querySelector("canvas").after(this.canvas);
  }

  resize(width, height) {
    if (this.canvas.width === width && this.canvas.height === height && this.image) return;
    Object.assign(this.canvas, { width, height });
    this.image = new ImageData(width, height);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.nearest = new Int32Array((width + 2 * RIM) * (height + 2 * RIM));
  }

  shape(kind, size) {
    const key = 64 * kind + size;
    if (!this.shapes.has(key)) this.shapes.set(key, shapeRows(kind, size));
    return this.shapes.get(key);
  }

  // Colours of each kind at each level of fading, as numbers of pixels.
  palette({ tints, behind }) {
    return Uint32Array.from(tints.value.flatMap((tint, kind) => Array.from({ length: LEVELS }, (_, level) => {
      const own = tint.clone().lerp(behind.value, (kind < 2 ? .35 : .1) * level / (LEVELS - 1));
      return (255 << 24 | Math.round(255 * own.b) << 16 | Math.round(255 * own.g) << 8 | Math.round(255 * own.r)) >>> 0;
    })));
  }

  // Draw points of levels 0 to 65535 along each axis, by a matrix from shares of the box to the screen.
  draw(levels, kinds, matrix, uniforms, width, height) {
    this.resize(width, height);
    this.placePoints(levels, kinds, matrix, uniforms, width, height);
    this.colourPixels(this.palette(uniforms), width, height);
    this.context.putImageData(this.image, 0, 0);
  }

  placePoints(levels, kinds, matrix, uniforms, width, height) {
    const numbers = Float64Array.of(...matrix.elements.map((value, place) => (place < 12 ? value / 65535 : value)), width, height, ...NUMBERS.map(name => uniforms[name].value), ...uniforms.sizes.value);
    const shapes = KINDS.flatMap((_, kind) => Array.from({ length: RIM + 1 }, (_, size) => this.shape(kind, size)));
    this.nearest.fill(NOTHING);
    for (let row = 0; row < kinds.length; row += BATCH) placeBatch(this.nearest, levels, kinds, numbers, shapes, row, Math.min(row + BATCH, kinds.length));
  }

  colourPixels(palette, width, height) {
    const { nearest, pixels } = this;
    for (let line = 0, to = 0; line < height; line++)
      for (let from = (line + RIM) * (width + 2 * RIM) + RIM, end = from + width; from < end; from++, to++) {
        const value = nearest[from];
        pixels[to] = value === NOTHING ? 0 : palette[value & TINTS];
      }
  }

  // Labels are in front of all points, as those of WebGL are.
  drawLabels(sprites, camera, ratio) {
    for (const { visible, position, userData, material } of sprites) {
      const at = position.clone().project(camera), tall = ratio * userData.pixels, wide = tall * userData.ratio;
      if (!visible || at.z > 1) continue;
      this.context.drawImage(material.map.image, (.5 + .5 * at.x) * this.canvas.width - wide / 2, (.5 - .5 * at.y) * this.canvas.height - tall / 2, wide, tall);
    }
  }

  clear() {
    this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
  }
}
