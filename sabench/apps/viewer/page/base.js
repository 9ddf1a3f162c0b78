// The page's script: its files are joined in the order base, colours, raster, space, rig, objects, planes, images, main.
// No text of a data set becomes markup, a style or code: it is only ever a text node or text on a canvas.
const data = JSON.parse(document.getElementById("data").textContent);
const ARRAYS = { Uint8: Uint8Array, Int16: Int16Array, Uint16: Uint16Array, Int32: Int32Array, Uint32: Uint32Array, Float32: Float32Array };
const UNKNOWN = -32768;  // a velocity that is not known
const KINDS = data.kinds, ALONE = !("found" in data.labels);  // the truth without a result

function bytesOf(text) {
  const raw = atob(text.trim()), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

async function unpack() {
  const packed = bytesOf(document.getElementById("arrays").textContent);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  return data.arrays.map(([kind, offset, count]) => new ARRAYS[kind](buffer, offset, count));
}

function labelOf(kind) {
  return data.labels[kind] ?? kind;
}

function tick(text, checked, change, icon = null, count = null) {
  const box = make("input", { type: "checkbox", checked, change: event => change(event.target.checked) });
  return make("label", { class: "tick" }, box, icon, make("span", {}, text), count);
}

function slide(text, { least, most, step, value, show }, change) {
  const out = make("output", {}, show(value));
  const input = make("input", {
    type: "range", min: least, max: most, step, value, "aria-label": text,
    input: event => { out.textContent = show(+event.target.value); change(+event.target.value); },
  });
  return make("label", { class: "slide" }, make("span", {}, text), input, out);
}

// What is shown; every part of the page reads it, and `changed` tells all of them.
const state = {
  frame: 0, camera: 0, plane: 0, stack: 0,
  kinds: Object.fromEntries(KINDS.map(kind => [kind, true])),
  bubbles: true, solids: true, cameras: true, frusta: "all", wall: true, sheet: true, volume: true, labels: true,
  size: 1, tail: 0, vectors: 0, slice: false,
};
const listeners = [];
function changed(...what) {
  for (const listener of listeners) listener(new Set(what));
}
