// Plots by the embedded library, drawn when their view is opened. Specifications hold fixed words only: a record's text is a value in their data.
const PALETTES = {
  light: ["#0072b2", "#c44e00", "#00795a", "#a6377f", "#8a6500", "#1f1f1f", "#5b52c9", "#b3261e"],
  dark: ["#56b4e9", "#ff9d4d", "#35c79a", "#ee9bc9", "#f0e442", "#e8e8e8", "#b3adff", "#ff8a80"],
};
const MARKERS = [  // paths in a box from -1 to 1, for the plot and its legend
  "M-.8,0a.8,.8 0 1,0 1.6,0a.8,.8 0 1,0 -1.6,0Z", "M-.7,-.7h1.4v1.4h-1.4Z", "M0,-.9L.9,.7H-.9Z", "M0,-1L.8,0L0,1L-.8,0Z", "M0,.9L.9,-.7H-.9Z",
  "M-.3,-1h.6v.7h.7v.6h-.7v.7h-.6v-.7h-.7v-.6h.7Z", "M-.9,0L.7,-.9V.9Z",
];
const GROUPED = { paddingInner: 0.5, paddingOuter: 0.25 };  // of solvers side by side
const DASHES = [[1, 0], [8, 3], [2, 3], [10, 3, 2, 3], [5, 5]];  // of lines, the full one first
const MOST = 20;  // solvers in a plot of difficulty: beyond them it shows nothing

function dark() {
  return matchMedia("(prefers-color-scheme: dark)").matches;
}

const solversOf = {};  // all of a task, by name

// One colour and one marker for every solver of the task, the same in all plots.
function lookOf(solver) {
  solversOf[state.task] ??= values(byTask[state.task], solverOf);
  const place = solversOf[state.task].indexOf(solver), palette = PALETTES[dark() ? "dark" : "light"];
  return { colour: palette[place % palette.length], shape: MARKERS[place % MARKERS.length], dash: DASHES[place % DASHES.length] };
}

function legend(solvers, lined) {
  const items = solvers.map(solver => {
    const look = lookOf(solver), wide = lined ? 44 : 16;
    const mark = drawn_("svg", { viewBox: `${-wide / 2} -8 ${wide} 16`, width: wide, height: 16, "aria-hidden": "true" });
    if (lined) mark.append(drawn_("line", { x1: -wide / 2, x2: wide / 2, stroke: look.colour, "stroke-width": 2, "stroke-dasharray": look.dash.join(" ") }));
    mark.append(drawn_("path", { d: look.shape, transform: "scale(5.5)", fill: "none", stroke: look.colour, "stroke-width": 2, "vector-effect": "non-scaling-stroke" }));
    return make("li", {}, mark, solver);
  });
  return make("ul", { class: "legend", "aria-label": "Solvers" }, items);
}

function drawn_(tag, attributes) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

function theme() {
  const css = getComputedStyle(document.documentElement), of = name => css.getPropertyValue(name).trim();
  const axis = { labelColor: of("--text"), titleColor: of("--text"), gridColor: of("--line"), domainColor: of("--quiet"), tickColor: of("--quiet") };
  return { background: null, font: "system-ui, sans-serif", view: { stroke: null }, axis: { ...axis, labelFontSize: 12, titleFontSize: 12, titleFontWeight: "normal" } };
}

// What a mark stands for, beside the pointer; text only.
function tip(handler, event, item, value) {
  document.getElementById("tip")?.remove();
  if (!value) return;
  const box = make("div", { id: "tip", role: "tooltip" }, String(value));
  document.body.append(box);
  const left = Math.min(event.clientX + 12, innerWidth - box.offsetWidth - 8);
  box.style.left = `${Math.max(8, left) + scrollX}px`;
  box.style.top = `${event.clientY + 16 + scrollY}px`;
}

function plot(spec, label) {
  const place = make("div", { class: "plot" });
  const options = { mode: "vega-lite", ast: true, actions: false, defaultStyle: false, renderer: "svg", tooltip: tip, config: theme() };
  const whole = { width: "container", description: label, autosize: { type: "fit", contains: "padding" }, ...spec };
  // the library comes after this script
  whenLoaded(() => requestAnimationFrame(() => vegaEmbed(place, whole, options).then(
    view => { place.dataset.drawn = "yes"; place.view = view; },
    error => place.append(make("p", { class: "error" }, `This plot cannot be drawn: ${error.message}`)))));
  return place;
}

const LOOKS = {
  color: { field: "colour", type: "nominal", scale: null, legend: null },
  shape: { field: "shape", type: "nominal", scale: null, legend: null },
};
const TOLD = { tooltip: { field: "text", type: "nominal" }, description: { field: "text", type: "nominal" } };

const POINT = { type: "point", filled: false, strokeWidth: 2, size: 110, opacity: 1 };  // hollow: none hides another of another shape

// Points with their intervals: x and y are encodings, `along` is the one ("x" or "y") that has fields low and high.
function points(rows, x, y, along) {
  const value = along === "x" ? x : y;
  if (!rows.some(row => row.low !== null)) return [{ data: { values: rows }, mark: POINT, encoding: { x, y, ...LOOKS, ...TOLD } }];
  const span = { ...LOOKS, [along]: { ...value, field: "low" }, [`${along}2`]: { field: "high" } };
  delete span.shape;
  return [
    { data: { values: rows.filter(row => row.low !== null) }, mark: { type: "rule", strokeWidth: 1.5 }, encoding: { x, y, ...span } },
    { data: { values: rows }, mark: POINT, encoding: { x, y, ...LOOKS, ...TOLD } },
  ];
}

function plotted(row, score, column, more) {
  const solver = solverOf(row);
  return { solver, ...lookOf(solver), low: null, high: null, ...spanOf(score), value: score[0], text: `${solver}: ${column.heading} ${shown(score, column.decimals)}${more}` };
}

// The numbers of a plot as lines of a file.
function plottedRows(points_, column, along, words_ = along) {
  return points_.map(one => ({ [words_]: one[along], solver: one.solver, [column.heading]: one.value, low: one.low ?? "", high: one.high ?? "" }));
}

function spanOf([mean, half]) {
  return half === undefined ? {} : { low: mean - half, high: mean + half };
}

function scoreChoice(columns) {
  const key = columns.some(column => column.key === state.y) ? state.y : columns[0].key;
  return { key, select: selector("Score", key, columns.map(column => [column.key, column.heading]), y => change({ y })) };
}

// Accuracy against time of one case.

const NO_SCORES = "Without truth, results of this task have no figures but their costs.";
const TIMES = { seconds: "seconds", kernels: "multiples of the reference time" };

function timeView(rows) {
  const cases = [...new Set(rows.map(row => row.case))].map(place => data.cases[place]);
  if (!cases.length) return [nothing()];
  if (!accuracies().length) return [nothing(NO_SCORES)];
  const own = cases.find(one => one.id === state.case) ?? mostSolved(rows);
  const select = selector("Case", own.id, cases.map(one => [one.id, nameOf(one, cases)]), id => change({ case: id }));
  const columns = accuracies(), { key, select: second } = scoreChoice(columns);
  const clock = rows.some(row => row.reference) ? selector("Time", TIMES[state.x] ? state.x : "seconds", Object.entries(TIMES), x => change({ x })) : null;
  return [make("div", { class: "form" }, select, second, clock), timePlot(rows.filter(row => caseOf(row) === own), columns.find(column => column.key === key), own)];
}

function meant(column) {
  const { columns, larger } = data.tasks[state.task];
  return `${column.heading}: ${column.meaning}${column.key === columns[0].key && larger !== null ? `; ${larger ? "larger" : "smaller"} is better` : ""}.`;
}

// The first score that some row has.
function firstKnown(rows) {
  const columns = accuracies();
  return columns.find(column => rows.some(row => scoreOf(row, column.key))) ?? columns[0];
}

function accuracies() {
  return data.tasks[state.task].columns.filter(column => column.key !== "seconds" && column.key !== "peak_mb");
}

function mostSolved(rows) {
  const counts = new Map();
  for (const row of rows) if (row.scores[0]) counts.set(row.case, (counts.get(row.case) ?? 0) + 1);
  const best = Math.max(...counts.values());
  return data.cases[[...counts].find(([, count]) => count === best)?.[0] ?? rows[0].case];
}

function timePlot(rows, column, own) {
  if (!column) return nothing(NO_SCORES);
  const inKernels = state.x === "kernels";
  const known = rows.filter(row => !row.error && scoreOf(row, column.key) && scoreOf(row, "seconds")?.[0] > 0 && (!inKernels || row.reference));
  if (!known.length) return nothing(`No solver of this case has both this score and a time${inKernels ? " in multiples of the reference time" : ""}.`);
  const points_ = known.map(row => {
    const seconds = scoreOf(row, "seconds");
    return { ...plotted(row, scoreOf(row, column.key), column, `, ${shown(seconds, 2)} s${row.wholeProcess ? ` ${PROCESS}` : ""}, ${listed([textOf(row.machine)].filter(Boolean), "machine unknown")}`), time: seconds[0] / (inKernels ? row.reference : 1) };
  });
  const x = { field: "time", type: "quantitative", scale: { type: "log" }, title: TIMES[state.x] ?? "seconds", axis: { labelOverlap: true, gridOpacity: 0.5 } };
  const y = { field: "value", type: "quantitative", scale: { zero: false, padding: 10 }, title: column.heading };
  const label = `${column.heading} against time of ${known.length} results of the case ${own.name}; the table says the same in numbers`;
  const steps = column.key === data.tasks[state.task].columns[0].key ? stepsOf(known, column, inKernels) : [];
  const drawing = plot({ height: 380, layer: [...lines(steps, x, y), ...points(points_, x, y, "y")] }, label);
  return make("figure", {}, drawing, legend(values(known, solverOf)), plotDownloads(drawing, `${column.heading} against time ${own.name}`, () => plottedRows([...points_, ...steps], column, "time", "seconds or multiples")),
    make("figcaption", { class: "quiet" }, `${meant(column)} Bars are 95 % confidence intervals over the seeds; time is of the solver alone, on the machine that a point's tip names; `
      + "its multiple is that time divided by the time of a fixed computation on the same machine in the same run."
      + (steps.length ? " Lines lead through the score after iterations 1, 2, 3, 5, 8, ... of the first frame of one seed." : "")
      + (known.some(row => row.wholeProcess) ? ` ${PROCESS_TEXT}` : "")));
}

// The score after iterations of solvers that tell it.
function stepsOf(rows, column, inKernels) {
  return rows.filter(row => row.iterations).flatMap(row => row.iterations.filter(one => one[1] > 0).map(([number, seconds, score]) => ({
    ...plotted(row, [score], column, `, ${shown([seconds], 2)} s, after ${number} iteration${number === 1 ? "" : "s"}`), row: row.id, number, time: seconds / (inKernels ? row.reference : 1) })));
}

function lines(steps, x, y) {
  if (!steps.length) return [];
  const { color } = LOOKS, encoding = { x, y, color };
  return [
    { data: { values: steps }, mark: { type: "line", strokeWidth: 1.2, opacity: 0.8 }, encoding: { ...encoding, detail: { field: "row", type: "nominal" }, order: { field: "number", type: "quantitative" } } },
    { data: { values: steps }, mark: { type: "point", filled: true, size: 25, opacity: 1 }, encoding: { ...encoding, ...TOLD } },
  ];
}

// Scores by difficulty, and what each axis costs against the standard case of the same suite.

function whyView(rows) {
  const groups = groupsOf(rows);
  if (!groups.size) return [nothing("None of these results is of a case that is said to be easy, standard or hard.")];
  const own = groups.has(state.group) ? state.group : [...groups.keys()][0];
  const columns = accuracies(), { key, select: second } = scoreChoice(columns), column = columns.find(one => one.key === key);
  const select = selector("Suite", own, [...groups.keys()].map(name => [name, name]), group => change({ group }));
  return [make("div", { class: "form" }, select, second), ...whyPlots(groups.get(own), column)];
}

function groupsOf(rows) {
  const groups = new Map();
  for (const row of rows) {
    const own = caseOf(row);
    if (!own.difficulty && !own.axis) continue;
    const name = listed([own.suite ?? own.scene, own.renderer, own.split === "hidden" && "hidden split"].filter(Boolean));
    if (!groups.has(name)) groups.set(name, []);
    groups.get(name).push(row);
  }
  return groups;
}

function whyPlots(rows, column) {
  const all = values(rows, solverOf), best = [...all].sort((a, b) => rankOf(rows, a) - rankOf(rows, b)).slice(0, MOST);
  const known = rows.filter(row => best.includes(solverOf(row)) && !row.error && scoreOf(row, column.key));
  const levels = levelsOf(known, column, best), losses = lossesOf(known, column, best);
  const note = all.length > MOST ? make("p", { class: "quiet" }, `The ${MOST} best of ${all.length} solvers; the filter chooses others.`) : null;
  const solvers = best.filter(solver => known.some(row => solverOf(row) === solver));
  return [note, legend(solvers), levels.length ? levelPlot(levels, column) : nothing("No solver has this score at any difficulty."),
    losses.length ? lossPlot(losses, column) : nothing("No solver has this score in a case of an axis and in its standard case.")].filter(Boolean);
}

function rankOf(rows, solver) {
  const own = rows.filter(row => solverOf(row) === solver && row.ranked && row.scores[0]).map(row => row.scores[0][0]);
  return own.length ? (data.tasks[state.task].larger ? -1 : 1) * meanOf(own)[0] : Infinity;
}

// The mean of several cases' means; its half width if all of them have one.
function joined(scores) {
  const mean = meanOf(scores.map(score => score[0]))[0];
  if (scores.some(score => score.length < 2)) return [mean];
  return [mean, Math.hypot(...scores.map(score => score[1])) / scores.length];
}

// A solver's best row of every case: other machines and parameters are in the table.
function bestOf(rows, solver) {
  const found = new Map();
  for (const row of rows) if (solverOf(row) === solver && !found.has(row.case)) found.set(row.case, row);
  return [...found.values()];
}

function levelsOf(rows, column, solvers) {
  const plain = rows.filter(row => !caseOf(row).axis), out = [];
  for (const difficulty of DIFFICULTIES) {
    const level = plain.filter(row => caseOf(row).difficulty === difficulty), count = new Set(level.map(row => row.case)).size;
    for (const solver of solvers) {
      const own = bestOf(level, solver);
      if (!own.length || own.length < count) continue;  // a mean over fewer cases than the others' would say nothing
      const cases = count > 1 ? `, mean of ${count} cases` : "";
      out.push({ ...plotted(own[0], joined(own.map(row => scoreOf(row, column.key))), column, `, ${difficulty}${cases}`), difficulty });
    }
  }
  return out;
}

function lossesOf(rows, column, solvers) {
  const out = [], larger = data.tasks[state.task].larger;
  for (const solver of solvers) {
    const own = bestOf(rows, solver);
    const standard = own.filter(row => caseOf(row).difficulty === "standard" && !caseOf(row).axis);
    for (const row of own.filter(one => caseOf(one).axis)) {
      const same = standard.filter(one => caseOf(one).scene === caseOf(row).scene), base = same.length ? same : standard;
      if (!base.length) continue;
      const with_ = scoreOf(row, column.key), without = joined(base.map(one => scoreOf(one, column.key)));
      const sure = with_.length > 1 && without.length > 1;
      const lost = [with_[0] - without[0], ...(sure ? [Math.hypot(with_[1], without[1])] : [])];
      const { axis, name, difficulty } = caseOf(row);
      out.push({ ...plotted(row, lost, column, ` against the standard case, in ${name}`), axis: difficulty && difficulty !== "standard" ? `${axis}, ${difficulty}` : axis });
    }
  }
  return out;
}

function levelPlot(levels, column) {
  const x = { field: "difficulty", type: "ordinal", scale: { domain: DIFFICULTIES, ...GROUPED }, title: "difficulty", axis: { labelAngle: 0 } };
  const y = { field: "value", type: "quantitative", scale: { zero: false, padding: 10 }, title: column.heading };
  const offset = { xOffset: { field: "solver", type: "nominal" } };
  const layer = points(levels, x, y, "y").map(one => ({ ...one, encoding: { ...one.encoding, ...offset } }));
  const drawing = plot({ height: 320, layer }, `${column.heading} of easy, standard and hard cases`);
  return make("figure", {}, make("h2", {}, "By difficulty"), drawing, plotDownloads(drawing, `${column.heading} by difficulty`, () => plottedRows(levels, column, "difficulty")),
    make("figcaption", { class: "quiet" }, `${meant(column)} Bars are 95 % confidence intervals over the seeds.`));
}

function lossPlot(losses, column) {
  const x = { field: "value", type: "quantitative", title: `change of ${column.heading} against the standard case` };
  const y = { field: "axis", type: "nominal", title: null, axis: { labelLimit: 130 } };
  const offset = { yOffset: { field: "solver", type: "nominal" } };
  const layer = points(losses, x, y, "x").map(one => ({ ...one, encoding: { ...one.encoding, ...offset } }));
  const zero = { data: { values: [{ value: 0 }] }, mark: { type: "rule", strokeDash: [4, 4], color: theme().axis.domainColor }, encoding: { x: { field: "value", type: "quantitative" } } };
  const steps = new Set(losses.map(one => one.axis)).size * Math.max(3, new Set(losses.map(one => one.solver)).size);
  const drawing = plot({ height: Math.max(140, 16 * steps), layer: [zero, ...layer] }, `change of ${column.heading} by axis`);
  return make("figure", {}, make("h2", {}, "What each axis costs"), drawing, plotDownloads(drawing, `change of ${column.heading} by axis`, () => plottedRows(losses, column, "axis")),
    make("figcaption", { class: "quiet" }, `Each axis changes one thing of the standard case. ${meant(column)} Left of the dashed line the score is smaller than there, right of it larger; `
      + "bars are 95 % confidence intervals of the difference of the two cases' means."));
}

function nothing(text = "No results are left: loosen the filters.") {
  return make("p", { class: "none" }, text);
}
