// Two figures of a case on top of each other: a slider uncovers one of them, and both zoom and move together.
const ZOOMS = [1, 2, 4, 8];

// Everything of a case that can be compared: [key, words, data URL, row].
function figuresOf(rows, own) {
  const album = albumOf(own), { errors } = data.tasks[state.task].pictured;
  const word = own.recorded ? "residuals" : "errors";
  const of = row => [["row", titleOf(row, rows)], ["error", `${titleOf(row, rows)}: ${word}`]].map(([kind, text]) => [`${kind}:${row.id}`, text, album[kind + row.place], row]);
  return [["truth", "truth", album.truth], ...rows.flatMap(of)].filter(([key, , text]) => text && (errors || !key.startsWith("error")));
}

function viewer(rows, own) {
  const figures = figuresOf(rows, own);
  if (figures.length < 2) return [];
  const left = figures.find(([key]) => key === state.left) ?? figures[0];
  const right = figures.find(([key]) => key === state.right) ?? figures.find(one => one !== left);
  const options = figures.map(([key, text]) => [key, text]);
  const { heading: title } = data.tasks[state.task].pictured;
  const stage_ = stage(left, right, title);
  return [make("section", { id: "viewer", "aria-label": "Figures compared" }, make("h3", {}, "Two figures on top of each other"),
    make("div", { class: "form" }, selector("Left", left[0], options, key => change({ left: key })), selector("Right", right[0], options, key => change({ right: key }))), stage_)];
}

function stage([leftKey, leftName, leftImage], [rightKey, rightName, rightImage], title) {
  const under = picture(leftKey.split(":")[0], leftImage, `${title}: ${leftName}`), over = picture(rightKey.split(":")[0], rightImage, `${title}: ${rightName}`);
  const cover = make("div", { class: "cover" }, over), handle = make("div", { class: "handle" });
  const frame = make("div", { class: "frame", tabindex: "0", role: "group", "aria-label": "Figures: arrow keys move, plus and minus zoom" }, under, cover, handle);
  const view = { zoom: 1, x: 0, y: 0, share: 50 };
  const slider = make("input", { type: "range", min: "0", max: "100", value: "50", "aria-label": `share of ${leftName}`, input: event => { view.share = Number(event.target.value); draw(); } });
  const buttons = ZOOMS.map(zoom => make("button", { type: "button", class: "small", "aria-pressed": String(zoom === 1), click: () => { view.zoom = zoom; draw(); } }, `${zoom}×`));
  function draw() {
    const most = (1 - 1 / view.zoom) / 2 * 100;  // percent of the figure that may leave the frame on either side
    view.x = Math.min(most, Math.max(-most, view.x));
    view.y = Math.min(most, Math.max(-most, view.y));
    for (const one of [under, over]) one.style.transform = `scale(${view.zoom}) translate(${view.x}%, ${view.y}%)`;
    cover.style.clipPath = `inset(0 0 0 ${view.share}%)`;
    handle.style.left = `${view.share}%`;
    buttons.forEach((button, place) => button.setAttribute("aria-pressed", String(ZOOMS[place] === view.zoom)));
  }
  frame.addEventListener("keydown", event => {
    const step = 10 / view.zoom, moves = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    const zoomed = { "+": 1, "=": 1, "-": -1 }[event.key];
    if (zoomed) view.zoom = ZOOMS[Math.min(ZOOMS.length - 1, Math.max(0, ZOOMS.indexOf(view.zoom) + zoomed))];
    else if (moves[event.key]) { view.x += moves[event.key][0]; view.y += moves[event.key][1]; } else return;
    event.preventDefault();
    draw();
  });
  dragged(frame, (across, down) => {
    view.x += across / view.zoom;
    view.y += down / view.zoom;
    draw();
  }, share => { view.share = share; slider.value = String(share); draw(); });
  draw();
  return make("figure", { class: "stage" }, frame, make("div", { class: "swipe" }, make("span", {}, leftName), slider, make("span", {}, rightName)),
    make("p", { class: "saves" }, "Zoom ", buttons));
}

// A pointer near the handle moves it, elsewhere the figures; percent of the frame.
function dragged(frame, move, swipe) {
  let last = null;
  frame.addEventListener("pointerdown", event => {
    const box = frame.getBoundingClientRect(), at = frame.querySelector(".handle").getBoundingClientRect();
    last = { x: event.clientX, y: event.clientY, box, swiping: Math.abs(event.clientX - at.left) < 16 };
    frame.setPointerCapture(event.pointerId);
  });
  frame.addEventListener("pointermove", event => {
    if (!last) return;
    if (last.swiping) swipe(Math.round(Math.min(100, Math.max(0, (event.clientX - last.box.left) / last.box.width * 100))));
    else move((event.clientX - last.x) / last.box.width * 100, (event.clientY - last.y) / last.box.height * 100);
    [last.x, last.y] = [event.clientX, event.clientY];
  });
  for (const end of ["pointerup", "pointercancel"]) frame.addEventListener(end, () => { last = null; });
}
