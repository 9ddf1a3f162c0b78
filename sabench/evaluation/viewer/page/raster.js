// Points drawn by the page itself, for browsers that draw without a graphics card: there, a point of WebGL takes microseconds, and here tens of nanoseconds.
const LEVELS = 16;  // of the fading with distance
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
    this.image = new ImageData(width + 2 * RIM, height + 2 * RIM);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.depth = new Float32Array(this.pixels.length);
  }

  shape(kind, size) {
    const key = 64 * kind + size;
    if (!this.shapes.has(key)) this.shapes.set(key, shapeRows(kind, size));
    return this.shapes.get(key);
  }

  // Colours of each kind at each level of fading, as numbers of pixels.
  palette({ tints, behind }) {
    return Uint32Array.from(tints.value.flatMap(tint => Array.from({ length: LEVELS }, (_, level) => {
      const own = tint.clone().lerp(behind.value, .35 * level / (LEVELS - 1));
      return (255 << 24 | Math.round(255 * own.b) << 16 | Math.round(255 * own.g) << 8 | Math.round(255 * own.r)) >>> 0;
    })));
  }

  // Draw points of levels 0 to 65535 along each axis, by a matrix from shares of the box to the screen.
  draw(levels, kinds, matrix, uniforms, width, height) {
    this.resize(width, height);
    const { pixels, depth } = this, wide = width + 2 * RIM, low = RIM / 2, right = wide - low, below = height + 2 * RIM - low;
    const palette = this.palette(uniforms), sizes = Float64Array.from(uniforms.sizes.value), count = kinds.length;
    const [a, d, , g, b, e, , h, c, f, , i, p, q, , r] = matrix.elements.map((value, place) => (place < 12 ? value / 65535 : value));
    const [scale, least, most, near, far] = ["scale", "least", "most", "near", "far"].map(name => uniforms[name].value), fade = (LEVELS - 1) / (far - near);
    const shapes = KINDS.flatMap((_, kind) => Array.from({ length: RIM + 1 }, (_, size) => this.shape(kind, size)));
    pixels.fill(0);
    depth.fill(Infinity);
    for (let row = 0, at = 0; row < count; row++, at += 3) {
      const kind = kinds[row], size = sizes[kind];
      if (size === 0) continue;
      const x = levels[at], y = levels[at + 1], z = levels[at + 2], w = g * x + h * y + i * z + r;
      if (w <= 0) continue;
      const column = ((.5 + .5 * (a * x + b * y + c * z + p) / w) * width + RIM + .5) | 0, line = ((.5 - .5 * (d * x + e * y + f * z + q) / w) * height + RIM + .5) | 0;
      if (column < low || line < low || column >= right || line >= below) continue;
      const wanted = scale / w, own = (size * (wanted < least ? least : wanted > most ? most : wanted) + .5) | 0;
      const level = w <= near ? 0 : w >= far ? LEVELS - 1 : ((w - near) * fade) | 0, tint = palette[kind * LEVELS + level];
      if (own <= 1) {
        const place = line * wide + column;
        if (w < depth[place]) { depth[place] = w; pixels[place] = tint; }
        continue;
      }
      const rows = shapes[kind * (RIM + 1) + (own > RIM ? RIM : own)];
      for (let k = 0; k < rows.length; k += 3) {
        const start = (line + rows[k]) * wide + column, last = start + rows[k + 2];
        for (let place = start + rows[k + 1]; place <= last; place++)
          if (w < depth[place]) { depth[place] = w; pixels[place] = tint; }
      }
    }
    this.context.putImageData(this.image, -RIM, -RIM);
  }

  clear() {
    this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
  }
}
