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
  return make("img", { src: text, alt: alternative });
}

function figure(text, alternative, ...caption) {
  return make("figure", {}, image(text, alternative), make("figcaption", {}, ...caption));
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
    ...tableView(rows), ...viewer(rows, own), ...gallery(rows, own), ...comparison(rows, own), ...toleranceOf(rows),
    make("h3", {}, "Accuracy against time"), timePlot(rows, firstKnown(rows), own),
  ].filter(Boolean);
}

function gallery(rows, own) {
  const { heading: title, text, wide, cameras } = data.tasks[state.task].pictured, album = albumOf(own);
  const out = [];
  if (album.images) out.push(make("h3", {}, "Camera images"), make("div", { class: "cameras" },
    figure(album.images, `Camera images: ${own.name}`, make("span", { class: "quiet" }, cameras))));
  const left = rows.filter(row => album[`left${row.place}`]);
  if (left.length) out.push(make("h3", {}, "Residual images"), make("p", { class: "quiet" }, "The middle camera's first image, and what the particles of each solver leave of it."),
    make("div", { class: "row wide" }, left.map(row => figure(album[`left${row.place}`], `Residual image: ${titleOf(row, rows)}`, make("b", {}, titleOf(row, rows))))));
  const shots = figuresOf(rows, own);
  if (shots.length === 1) out.push(make("h3", {}, title), make("p", { class: "quiet" }, text), make("div", { class: wide ? "row wide" : "row" },
    shots.map(([, name, own_]) => figure(own_, `${title}: ${name}`, make("b", {}, name)))));
  const fewer = shots.length || album.images ? "" : "This page has no pictures of this case.";
  if (fewer) out.push(make("p", { class: "quiet" }, fewer));
  if (data.leftOut) out.push(make("p", { class: "quiet" }, `To keep the page small, ${data.leftOut} pictures of all cases are not in it: those of the lowest ranks.`));
  return out;
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
  const head = ["score", "first", "second", "first − second", "common seeds", "differs from 0?"];
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
    make("p", { class: "quiet" }, "The difference is the mean over the seeds that both have, of the first's score minus the second's on the same data, with half the width of its 95 % "
      + "confidence interval: “yes” where that interval does not hold zero."));
}
