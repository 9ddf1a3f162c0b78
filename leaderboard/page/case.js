// One case: its solvers, its pictures, and two solvers side by side.

function nameOf(own, others) {
  return others.filter(one => one.name === own.name).length > 1 ? `${own.name} (${own.id.slice(own.name.length + 1)})` : own.name;
}

function albumOf(own) {
  const block = document.getElementById(`album${data.cases.indexOf(own)}`);
  if (own.album === undefined) own.album = block ? JSON.parse(block.textContent) : {};
  return own.album;
}

function image(text, alternative) {
  // small figures are enlarged in blocks, large ones are reduced smoothly
  return make("img", { src: text, alt: alternative, load: ({ target }) => target.classList.toggle("crisp", target.naturalWidth < target.clientWidth) });
}

function isLit() {
  const { wide, errors } = data.tasks[state.task].pictured;
  return !wide && errors.startsWith("Found:");
}

// A figure of a task; found, missed and ghost particles on black are brightened.
function picture(kind, text, alternative) {
  const one = image(text, alternative);
  one.classList.toggle("lit", kind === "error" && isLit());
  return one;
}

function figure(shown_, ...caption) {
  return make("figure", {}, shown_, make("figcaption", {}, ...caption));
}

function caseView() {
  const own = data.cases.find(one => one.task === state.task && one.id === state.case);
  if (!own) return [nothing("This page has no such case in this task.")];
  const rows = byTask[state.task].filter(row => caseOf(row) === own);
  const facts = [own.suite && `suite ${own.suite}`, !own.recorded && `scene ${own.scene}`, own.difficulty, own.axis && `axis ${own.axis}`, own.axes, !own.recorded && `renderer ${own.renderer}`, `${own.recorded ? "data set" : "scene hash"} ${own.hash.slice(0, 12)}`];
  return [
    make("p", {}, make("a", { href: link({ view: "front", case: "", sort: "", page: "1", a: "", b: "", left: "", right: "" }) }, "Back to the ranking")),
    make("h2", { tabindex: "-1" }, own.name), own.recorded ? make("p", {}, make("span", { class: "chip" }, "recorded, no truth"), ` ${data.tasks[state.task].gate}`) : null,
    own.split === "hidden" ? make("p", {}, make("span", { class: "chip hidden" }, "hidden split"), " Its data sets are not published.") : null,
    make("p", { class: "quiet" }, listed(facts.filter(Boolean))),
    ...tableView(rows), unmeasuredNote(rows, "in this case"), ...gallery(rows, own), ...viewer(rows, own), ...comparison(rows, own), ...toleranceOf(rows),
    make("h3", {}, "Accuracy against time"), timePlot(rows, firstKnown(rows), own),
  ].filter(Boolean);
}

const REDUCED = " Bundled records keep reduced pictures; small ones are enlarged here without smoothing.";

const LIT = " The page brightens these colours.";

function reduced(texts) {
  return texts.some(text => text?.startsWith("data:image/webp")) ? REDUCED : "";
}

// All figures of the case: what all solvers share once, then one of each solver under its name.
function gallery(rows, own) {
  const { heading: title, estimates: text, wide, cameras, errors } = data.tasks[state.task].pictured, album = albumOf(own);
  const shots = figuresOf(rows, own), of = kind => shots.filter(([key]) => key.startsWith(kind));
  const grid = found => make("div", { class: wide ? "row wide" : "row" }, found.map(([key, name, own_, row]) => figure(picture(key.split(":")[0], own_, name), make("b", {}, row ? titleOf(row, rows) : name), row && scoreBeside(row))));
  const out = [], estimates = [...of("truth"), ...of("row")], maps = of("error"), left = rows.filter(row => album[`left${row.place}`]);
  if (album.images) out.push(make("h3", {}, "Camera images"), make("div", { class: "cameras" },
    figure(image(album.images, `Camera images: ${own.name}`), make("span", { class: "quiet" }, cameras))));
  if (maps.length) out.push(make("h3", {}, own.recorded ? "Residuals" : "Errors"), make("p", { class: "quiet" }, keyed(errors), isLit() ? LIT : "", reduced(maps.map(one => one[2]))), grid([...of("truth"), ...maps]));
  if (estimates.length) out.push(make("h3", {}, title), make("p", { class: "quiet" }, text, reduced(estimates.map(one => one[2]))), grid(estimates));
  if (left.length) out.push(make("h3", {}, "Residual images"), make("p", { class: "quiet" }, "The middle camera's first image, and what the particles of each solver leave of it."), residuals(left, album, rows));
  if (!out.length) out.push(make("p", { class: "quiet" }, "This page has no pictures of this case."));
  if (data.leftOut) out.push(make("p", { class: "quiet" }, `To keep the page small, ${data.leftOut} pictures of all cases are not in it: those of the lowest ranks.`));
  return out;
}

function scoreBeside(row) {
  const column = firstColumn();
  return row.scores[0] ? make("span", { class: "quiet few" }, `${column.heading} ${shown(row.scores[0], column.decimals)}`) : null;
}

// The camera's image is the upper part of every figure: it is shown once.
function residuals(left, album, rows) {
  const part = (row, name, below) => {
    const both = image(album[`left${row.place}`], name), box = make("div", { class: below ? "half below" : "half" }, both);
    both.addEventListener("load", () => { const gap = gapOf(both); if (gap) box.style.aspectRatio = `${both.naturalWidth} / ${gap}`; else box.classList.remove("half"); });
    return figure(box, make("b", {}, name), below ? scoreBeside(row) : null);
  };
  return make("div", { class: "row" }, part(left[0], "camera image", false), left.map(row => part(row, titleOf(row, rows), true)));
}

// The first row of the grey line between two images that lie on top of each other; 0 without one.
function gapOf(both) {
  const { naturalWidth: width, naturalHeight: height } = both, middle = Math.floor(height / 2);
  const canvas = make("canvas", { width, height }), context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(both, 0, 0);
  const grey = row => context.getImageData(0, row, width, 1).data.every(value => value > 130);
  let row = middle;
  if (!grey(row)) return 0;
  while (row > 0 && grey(row - 1)) row -= 1;
  return row;
}

function toleranceOf(rows) {
  const own = rows.filter(row => row.curve);
  return own.length ? [make("h3", {}, "Score over the matching tolerance"), tolerancePlot(own)] : [];
}

// Two solvers of one case.

function comparison(rows, own) {
  if (rows.length < 2) return [];
  const a = rows.find(row => row.id === state.a) ?? rows[0];
  const b = rows.find(row => row.id === state.b && row !== a) ?? rows.find(row => row !== a);
  const options = rows.map((row, place) => [row.id, `${place + 1}. ${titleOf(row, rows)}`]);
  const form = make("div", { class: "form" },
    selector("First", a.id, options, id => change({ a: id, b: id === b.id ? a.id : b.id })),
    selector("Second", b.id, options, id => change({ b: id, a: id === a.id ? b.id : a.id })));
  return [make("section", { id: "compare", "aria-label": "Two solvers compared" },
    make("h3", {}, "Two solvers compared"), form, differences(a, b))];
}

function titleOf(row, rows) {
  const twice = rows.filter(one => solverOf(one) === solverOf(row)).length > 1;
  const more = twice ? [textOf(row.parameters), row.submission?.name, textOf(row.machine)].filter(Boolean) : [];
  return more.length ? `${solverOf(row)} (${more.join("; ").slice(0, 80)})` : solverOf(row);
}

// Mean of the differences over the seeds that both have, with their number; null without one.
function paired(a, b, place) {
  const of = (row, i) => (row.values ? row.values[place][i] : row.scores[place]?.[0] ?? null);
  const found = [];
  a.seeds.forEach((seed, i) => {
    const j = b.seeds.indexOf(seed);
    if (j < 0) return;
    const [first, second] = [of(a, i), of(b, j)];
    if (first !== null && second !== null) found.push(first - second);
  });
  const mean = meanOf(found);
  return mean && { mean, count: found.length };
}

function verdict(difference) {
  if (!difference) return "no common seed";
  if (difference.mean.length < 2) return "one common seed: no interval";
  return Math.abs(difference.mean[0]) > difference.mean[1] ? "yes" : "no";
}

function differences(a, b) {
  const columns = data.tasks[state.task].columns.map((column, place) => ({ ...column, place })).filter(column => a.scores[column.place] || b.scores[column.place]);
  const names = [a, b].map(row => titleOf(row, [a, b])), head = ["score", ...names, "difference", "common seeds", "differs from 0?"];
  const lines = columns.map(column => {
    const difference = paired(a, b, column.place);
    return make("tr", { "data-key": column.key }, make("th", { scope: "row", title: column.meaning }, column.heading),
      [a, b].map(row => make("td", { class: "number" }, scoreWords(row, column))),
      make("td", { class: "number" }, shown(difference?.mean, column.decimals + 1)), make("td", { class: "number" }, String(difference?.count ?? 0)),
      make("td", {}, verdict(difference)));
  });
  const table = make("table", { class: "differences" }, make("caption", { class: "unseen" }, "Scores of the two and their differences"),
    make("thead", {}, make("tr", {}, head.map(text => make("th", { scope: "col", class: "plain" }, text)))), make("tbody", {}, lines));
  return make("div", {}, make("div", { class: "box differences-box", role: "region", "aria-label": "Scores of the two and their differences", tabindex: "0" }, table),
    make("p", { class: "quiet" }, `The difference is the mean over the seeds that both have, of the score of ${names[0]} minus that of ${names[1]} on the same data, with half the width of its 95 % `
      + "confidence interval: “yes” where that interval does not hold zero."));
}
