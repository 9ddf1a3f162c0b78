// What belongs together on the screen: the drawing, its controls, the pictures.
const main = document.getElementById("main");
const PRESETS = { rig: "whole rig", volume: "volume", x: "x", y: "y", z: "z" };
const ERRORS = new Set(["missed", "ghost", "duplicate"]);
const count = new Intl.NumberFormat("en");

function views(space, rig) {
  const whole = [...rig.corners, ...rig.bodies], side = sideOf(rig);
  const acts = {
    rig: () => space.look(whole, side),
    volume: () => space.look(rig.corners, side),
    x: () => space.look(rig.corners, new THREE.Vector3(-1, 0, 0)),
    y: () => space.look(rig.corners, new THREE.Vector3(0, -1, -.001)),
    z: () => space.look(rig.corners, new THREE.Vector3(0, 0, -1)),
  };
  const first = data.frames.length ? "volume" : "rig";
  space.home = acts[first];
  acts[first]();
  return make("div", { class: "views", role: "group", "aria-label": "Views" },
    Object.entries(PRESETS).map(([name, text]) => make("button", { type: "button", "data-view": name, "aria-label": text.length > 1 ? text : `along ${text}`, click: acts[name] }, text)));
}

// From beside the cameras, above the volume.
function sideOf(rig) {
  const towards = rig.centers.reduce((sum, one) => sum.add(one), new THREE.Vector3()).multiplyScalar(1 / rig.centers.length).sub(rig.middle);
  if (towards.length() < .2 * rig.rigRadius) towards.set(0, 0, -1);
  towards.normalize();
  const right = new THREE.Vector3().crossVectors(UP, towards);
  if (right.length() < .1) return new THREE.Vector3(-.5, -.6, -1);
  return towards.multiplyScalar(.8).addScaledVector(right.normalize(), .8).addScaledVector(UP, .45);
}

function timeBar() {
  const frames = data.frames;
  if (frames.length < 2) return null;
  const show = () => `frame ${frames[state.frame].number}, t = ${+frames[state.frame].time.toPrecision(5)} s`;
  const out = make("output", {}, show());
  const go = number => { state.frame = number; input.value = number; out.textContent = show(); changed("frame"); };
  const input = make("input", { type: "range", min: 0, max: frames.length - 1, step: 1, value: 0, "aria-label": "Frame", input: event => { stop(); go(+event.target.value); } });
  let timer = null;
  const stop = () => { clearInterval(timer); timer = null; button.textContent = "play"; };
  const button = make("button", { type: "button", click: () => {
    if (timer) { stop(); return; }
    button.textContent = "pause";
    timer = setInterval(() => go((state.frame + 1) % frames.length), 200);
  } }, "play");
  return make("div", { class: "time", id: "time" }, button, input, out);
}

// A button that leaves out what is right.
function onlyErrors(rows, ticks) {
  const button = make("button", { type: "button", "aria-pressed": "false", click: () => {
    const only = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", only);
    rows.forEach((kind, i) => { state.kinds[kind] = ticks[i].querySelector("input").checked = !only || ERRORS.has(kind); });
    changed("kinds");
  } }, "errors only");
  return button;
}

function legendCard(sort, title) {
  const rows = KINDS.filter(kind => data.totals[sort][kind]);
  if (!rows.length) return null;
  const counts = rows.map(kind => make("span", { class: "count" }));
  const fill = () => rows.forEach((kind, i) => { counts[i].textContent = count.format(data.totals[sort][kind][state.frame] ?? 0); });
  fill();
  listeners.push(what => { if (what.has("frame")) fill(); });
  const ticks = rows.map((kind, i) => tick(labelOf(kind), state.kinds[kind], on => { state.kinds[kind] = on; changed("kinds"); }, icon(kind, sort === "bubbles"), counts[i]));
  return make("fieldset", { class: "card", id: sort }, make("legend", {}, title), ticks, rows.some(kind => ERRORS.has(kind)) && !data.vectors ? onlyErrors(rows, ticks) : null,
    data.definition ? make("p", { class: "meaning" }, data.definition) : null);
}

function rigCard() {
  const some = (name, text, what = "rig") => tick(text, state[name], on => { state[name] = on; changed(what); });
  const frusta = make("select", { "aria-label": "Frusta", change: event => { state.frusta = event.target.value; changed("rig"); } },
    [["all", "frusta of all cameras"], ["one", "frustum of the chosen camera"], ["none", "no frusta"]].map(([value, text]) => make("option", { value, selected: value === state.frusta }, text)));
  return make("fieldset", { class: "card" }, make("legend", {}, "Rig"),
    some("cameras", `cameras (${data.rig.cameras.length})`), frusta,
    data.rig.walls.length ? some("wall", `wall: ${data.rig.walls[0].media.join(" | ")}`) : null,
    data.rig.sheet ? some("sheet", "light") : data.rig.backlight ? some("sheet", "backlight") : null,
    some("volume", "volume"), some("labels", "names and lengths"),
    data.frames.some(one => one.solids.length) ? some("solids", "bodies", "round") : null);
}

// Time over which velocities are drawn at most, s: usual ones then cross a fifth of the volume.
function longestStep() {
  return .2 * Math.hypot(...data.rig.volume[0].map((low, axis) => data.rig.volume[1][axis] - low)) / data.usual;
}

function drawCard() {
  if (!data.frames.length) return null;
  const parts = [];
  const moving = data.usual > 0;
  if (Object.keys(data.totals.particles).length) parts.push(slide("size of particles", { least: .4, most: 3, step: .1, value: 1, show: value => `x ${value}` }, value => { state.size = value; changed("size"); }));
  if (data.linked) parts.push(slide("paths, frames back", { least: 0, most: Math.min(data.frames.length - 1, 20), step: 1, value: state.tail, show: String }, value => { state.tail = value; changed("lines"); }));
  if (moving) {
    const most = longestStep();
    parts.push(slide("velocities", { least: 0, most: 1, step: .05, value: state.vectors / most, show: value => (value ? `${+(value * most * 1000).toPrecision(2)} ms` : "off") }, value => { state.vectors = value * most; changed("lines"); }));
  }
  return parts.length ? make("fieldset", { class: "card" }, make("legend", {}, "Draw"), parts) : null;
}

function speedRamp() {
  if (!data.usual) return null;
  const bar = make("i"), box = make("div", { class: "ramp", hidden: true }, "speed, mm/s", bar, make("span", {}, make("b", {}, "0"), make("b", {}, `${+data.usual.toPrecision(3)}`)));
  const show = () => {
    box.hidden = !state.vectors && !(ALONE && state.tail);
    bar.style.background = `linear-gradient(90deg, ${[0, .25, .5, .75, 1].map(share => `rgb(${ramp(share).map(value => Math.round(255 * value))})`).join(", ")})`;
  };
  listeners.push(what => { if (what.has("lines") || what.has("theme")) show(); });
  show();
  return box;
}

async function start() {
  const arrays = await unpack(), stage = make("div", { class: "stage", id: "stage" });
  const column = make("div", { class: "column" }, stage), panel = make("div", { class: "panel" });
  main.append(column, panel);
  if (data.linked) state.tail = Math.min(data.frames.length - 1, 6);
  if (data.frames.length) state.frusta = "one";
  if (data.vectors) Object.assign(state, { vectors: longestStep() / 2, kinds: { ...state.kinds, true: false } });
  let space = null, rig = null;
  try { space = new Space(stage); } catch { stage.append(make("p", { class: "lack" }, "This browser offers no WebGL, so nothing is drawn in space: see the pictures and the drawings and tables below.")); }
  const objects = space ? new Objects(space, rig = new Rig(space), arrays) : Object.assign(Object.create(Objects.prototype), { arrays, low: data.box?.low, size: data.box?.size });
  if (space) {
    stage.append(views(space, rig), speedRamp() ?? "", make("p", { class: "hint" }, "drag to turn, wheel to zoom, right button to move"));
    document.getElementById("tables").open = false;
  }
  column.append(timeBar() ?? "");
  panel.append(legendCard("particles", data.sort) ?? "", legendCard("bubbles", "Bubbles") ?? "", drawCard() ?? "", rigCard());
  const planes = data.stacks.length ? new Planes(space, objects, arrays) : null, images = data.frames.length ? new Images(objects, arrays) : null;
  if (planes || images) main.append(make("div", { class: "pictures" }, images?.card(), planes?.card()));
  else if (space) rigPicker(panel);
  dark.addEventListener("change", () => { readColours(); changed("theme"); });
  document.documentElement.dataset.ready = "yes";
  globalThis.sabenchView = { space, state, changed, objects, images };  // for tests and benchmarks
}

// Of a rig without images: which camera is chosen.
function rigPicker(panel) {
  panel.append(make("fieldset", { class: "card" }, make("legend", {}, "Chosen camera"),
    make("select", { "aria-label": "Camera", change: event => { state.camera = +event.target.value; changed("camera"); } },
      data.rig.cameras.map((one, number) => make("option", { value: number }, one.name)))));
}

start();
