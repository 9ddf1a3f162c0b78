// The ranking: solvers against easy, standard and hard cases, and curves of scores over what makes a case hard.
const MOST_SHOWN = 20;  // lines of a board before all are asked for
const MOST_CURVES = 10;  // solvers in a plot of curves
const LEAST_POINTS = 4;  // of a line

function boardsOfTask() {
  return data.boards.filter(one => one.task === state.task);
}

function boardShown() {
  const boards = boardsOfTask();
  return boards.find(one => one.title === state.group) ?? boards[0];
}

function rowsOfBoard(board) {
  const cases = board.columns.flatMap(column => column.cases);
  return byTask[state.task].filter(row => cases.includes(row.case));
}

function firstColumn() {
  return data.tasks[state.task].columns[0];
}

function frontView() {
  const boards = boardsOfTask(), board = boardShown();
  const all = make("p", {}, make("a", { href: link({ view: "table", group: "" }) }, `All ${byTask[state.task].length} results of this task`));
  if (!board) return [nothing(data.tasks[state.task].gate || "This task has no ranking."), all];
  const select = boards.length > 1 ? make("div", { class: "form" }, selector("Suite", board.title, boards.map(one => [one.title, one.title]), group => change({ group }))) : null;
  return [
    make("h2", {}, `Ranking: ${taskName(state.task)}`), select, boards.length > 1 ? null : make("p", { class: "quiet" }, board.title),
    boardTable(board), moreLines(board), unmeasuredNote(rowsOfBoard(board), "in this suite"), pictureNote(board), seedNote(board), speedNote(board), make("p", { class: "quiet" }, CODE_TEXT), downloads(`ranking of ${state.task} in ${board.title}`, () => boardRows(board)), boardLegend(board),
    ...curveSection(board), ...toleranceSection(board), all,
  ];
}

// Marks of a line: one case that was not confined is enough.
function lineChips(line) {
  const places = line.cells.flatMap(cell => cell.places), open_ = places.find(place => data.rows[place].open);
  return [...chips(data.rows[open_ ?? line.row]), line.also.length ? make("span", { class: "chip", title: line.also.join(", ") }, `also sent as ${line.also.slice(0, 3).join(", ")}`) : null];
}

function measured(line) {
  const rows = [...new Set([line.row, ...line.cells.flatMap(cell => cell.places)])].map(place => data.rows[place]), date = dateOf(rows);
  return [date && make("span", { class: "few quiet" }, `measured ${date}`), make("span", { class: "few quiet" }, versionOf(rows))];
}

function rankText(cell) {
  return cell.rank ? `${cell.tied ? "=" : ""}${cell.rank}` : "";
}

function timeText(cell) {
  if (cell.seconds === undefined) return "";
  const mark = cell.process ? ` ${PROCESS}` : "";
  return `${fixed(cell.seconds, 2)} s${mark}${cell.kernels === undefined ? "" : `, ${kernelText(cell.kernels)} × reference`}`;
}

function kernelText(kernels) {
  return kernels >= 10 ? fixed(kernels, 0) : kernels.toPrecision(2);
}

function boardCell(board, place, cell) {
  const own = board.columns[place], decimals = firstColumn().decimals;
  const score = cell.score ? make(cell.best ? "b" : "span", { class: "score" }, shown(cell.score, decimals)) : null;
  const link_ = cell.places.length === 1 ? make("a", { href: caseLink(data.rows[cell.places[0]]), title: `the ${own.name} case` }, score ?? cell.note) : score;
  const time = timeText(cell);
  return make("td", { "data-label": own.name, class: "standing" },
    make("span", { class: "rank" }, cell.rank ? rankText(cell) : DASH), " ", link_,
    cell.note && cell.score ? make("span", { class: "quiet few" }, cell.note) : null,
    cell.note && !cell.score && cell.places.length !== 1 ? make("span", { class: "quiet" }, cell.note) : null,
    time && make("span", { class: `few ${cell.sufficient ? "" : "quiet"}` }, cell.fastest ? make("b", {}, time) : time),
    cell.places.length === 1 && own.cases.length === 1 ? shot(data.rows[cell.places[0]]) : null);
}

function caseLink(row, changes = {}) {
  return link({ view: "case", case: caseOf(row).id, sort: "", page: "1", a: "", b: "", left: "", right: "", ...changes });
}

// A solver's error map, else its estimate; it is filled when the figures are there, which come last in the file.
function shot(row) {
  const box = make("span", { class: "shot", hidden: true });
  whenLoaded(() => {
    const { text, kind, words } = shotOf(row);
    if (!text) return;
    box.append(make("a", { href: caseLink(row, { right: `${kind}:${row.id}` }) }, picture(kind, text, `${words} of ${solverOf(row)}, ${caseOf(row).name}`)));
    box.hidden = false;
  });
  return box;
}

function shotOf(row) {
  const album = albumOf(caseOf(row)), errors = data.tasks[state.task].pictured.errors && album[`error${row.place}`];
  return errors ? { text: errors, kind: "error", words: "error map" } : { text: album[`row${row.place}`], kind: "row", words: "estimate" };
}

function truthLine(board) {
  const truths = board.columns.map(one => (one.cases.length === 1 ? albumOf(data.cases[one.cases[0]]).truth : null));
  if (!truths.some(Boolean)) return null;
  const cells = board.columns.map((one, place) => make("td", { "data-label": one.name, class: "standing" },
    truths[place] && make("span", { class: "shot" }, image(truths[place], `truth, ${data.cases[one.cases[0]].name}`))));
  return make("tr", { class: "truth" }, make("td", { class: "place" }), make("th", { scope: "row" }, "truth"), make("td", { class: "number" }), cells);
}

// What the pictures of the table show, once they are there.
function pictureNote(board) {
  const box = make("div", {});
  whenLoaded(() => {
    const shots = board.lines.flatMap(line => line.cells.filter(cell => cell.places.length === 1).map(cell => shotOf(data.rows[cell.places[0]]))).filter(one => one.text);
    if (!shots.length) return;
    const { heading: title, estimates: text, errors } = data.tasks[state.task].pictured, maps = shots[0].kind === "error";
    box.append(make("p", { class: "quiet" }, `${title}, first seed${maps ? ", error maps; the truth has a line of its own" : ""}. `, maps ? [...keyed(errors), isLit() ? LIT : ""] : text, reduced(shots.map(one => one.text))));
  });
  return box;
}

function boardTable(board) {
  const column = firstColumn(), label = `Ranking of ${taskName(state.task)} by ${column.heading}, ${board.title}`;
  const heads = board.columns.map(one => make("th", { scope: "col", class: "plain", title: column.meaning },
    one.cases.length === 1 ? make("a", { href: link({ view: "case", case: data.cases[one.cases[0]].id, a: "", b: "" }) }, one.name) : one.name,
    make("span", { class: "few quiet" }, `${column.heading}, ${one.seeds} ${one.seeds === 1 ? "seed" : "seeds"}${one.cases.length > 1 ? `, ${one.cases.length} cases` : ""}`)));
  const lines = board.lines.slice(0, state.all ? undefined : MOST_SHOWN).map(line => make("tr", { class: line.place ? null : "unplaced" },
    make("td", { class: "place", "data-label": "place" }, line.place ? String(line.place) : DASH),
    make("th", { scope: "row" }, make("span", { class: "name" }, wrapped(line.name)), lineChips(line), measured(line)),
    make("td", { class: "number", "data-label": "mean rank" }, fixed(line.meanRank, 2)),
    line.cells.map((cell, place) => boardCell(board, place, cell))));
  const body = make("tbody", {}, lines);
  whenLoaded(() => body.prepend(truthLine(board) ?? ""));
  return make("div", { class: "box", role: "region", "aria-label": label, tabindex: "0" }, make("table", { class: "board cards" }, make("caption", { class: "unseen" }, label),
    make("thead", {}, make("tr", {}, make("th", { scope: "col", class: "plain" }, "place"), make("th", { scope: "col", class: "plain" }, "solver"),
      make("th", { scope: "col", class: "plain number" }, "mean rank"), heads)), body));
}

function seedNote(board) {
  return board.columns.some(one => one.seeds === 1) ? make("p", { class: "quiet" }, "Of a single seed there is no interval: ranks may be chance.") : null;
}

function speedNote(board) {
  if (!board.lines.some(line => line.cells.some(cell => cell.kernels))) return null;
  return make("p", { class: "quiet" }, `Time: seconds of the solver. “× reference” is the same time divided by that of a fixed computation on the same machine in the same run, so that different machines can be compared. Speed counts from ${board.sufficient}; below it the time is grey. The fastest is bold.`);
}

function moreLines(board) {
  const hidden = state.all ? 0 : Math.max(0, board.lines.length - MOST_SHOWN);
  const rest = board.more ? `${board.more} further entries are among all results only.` : "";
  if (!hidden && !rest) return null;
  return make("p", {}, hidden ? make("button", { type: "button", click: () => change({ all: "1" }) }, `show ${hidden} more`) : null, ` ${rest}`);
}

function boardRows(board) {
  const { heading: first } = firstColumn();
  return board.lines.map(line => {
    const row = { place: line.place ?? "", solver: line.name, parameters: textOf(data.rows[line.row].parameters), "mean rank": line.meanRank };
    line.cells.forEach((cell, place) => {
      const { name } = board.columns[place];
      Object.assign(row, {
        [`${name}: rank`]: cell.rank ?? "", [`${name}: ${first}`]: cell.score?.[0] ?? "", [`${name}: half width`]: cell.score?.[1] ?? "",
        [`${name}: seconds`]: cell.seconds ?? "", [`${name}: times the reference`]: cell.kernels ?? "", [`${name}: note`]: cell.note ?? "",
      });
    });
    return row;
  });
}

function boardLegend(board) {
  const column = firstColumn(), larger = data.tasks[state.task].larger;
  return make("details", { class: "meaning" }, make("summary", {}, "How ranks are made"),
    make("p", { class: "quiet" }, `${column.heading}: ${column.meaning}; ${larger ? "larger" : "smaller"} is better. A rank is 1 plus the number of solvers that are better beyond chance: `
      + "the 95 % confidence interval of the mean difference, paired by seed, excludes zero. Solvers whose intervals do not part share a rank (“=”); none ranks before one with a better mean. "
      + "No correction is made for the number of pairs: of twenty, expect one to differ by chance. With one seed there is no interval, and scores rank as they are. The best mean is bold."),
    make("p", { class: "quiet" }, "Only results on the same data sets are compared. A solver without a rank somewhere (it failed, declined, lacks seeds or cases, or the task’s gate does not rank it) comes after all others; "
      + "its mean rank counts the rank after the last one there. A result that was sent again under another name takes no further rank. " + data.tasks[state.task].gate),
    make("p", { class: "quiet" }, `The reference is a fixed computation of some 15 ms on one thread. Speed counts from ${board.sufficient}, so that nobody is fast by being inaccurate.${board.lines.some(line => line.cells.some(cell => cell.process)) ? ` ${PROCESS_TEXT}` : ""}`));
}

// Curves over one property of the cases.

function curveSection(board) {
  const curves = data.curves.filter(one => one.task === state.task);
  const drawn_ = curves.filter(one => one.points.some(([, place]) => sameSuite(board, place)));
  if (!drawn_.length) return [];
  const own = drawn_[Number(state.curve)] ?? drawn_[0], columns = accuracies(), { key, select } = scoreChoice(columns);
  const column = columns.find(one => one.key === key);
  const choose = selector("Over", String(drawn_.indexOf(own)), drawn_.map((one, place) => [String(place), one.quantity]), curve => change({ curve }));
  return [make("h3", {}, "Score over one property of the scene"), make("div", { class: "form" }, choose, select), curvePlot(own, column)];
}

// Whether a case is of the suite, renderer and split of a board.
function sameSuite(board, place) {
  const [own, one] = [data.cases[board.columns[0].cases[0]], data.cases[place]];
  return own.suite === one.suite && own.renderer === one.renderer && own.split === one.split;
}

function curvePlot(curve, column) {
  const found = curve.points.flatMap(([value, place]) => byTask[state.task].filter(row => row.case === place && !row.error && scoreOf(row, column.key))
    .map(row => ({ ...plotted(row, scoreOf(row, column.key), column, `, ${curve.quantity} ${value}, ${caseOf(row).name}`), x: value, entry: `${solverOf(row)} ${row.parameters} ${row.machine} ${row.submission?.name ?? ""}` })));
  if (!found.length) return nothing("No solver has this score in these cases.");
  const kept = keptSolvers(found);
  const points_ = found.filter(one => kept.includes(one.solver));
  const x = { field: "x", type: "quantitative", title: curve.quantity, scale: curve.logarithmic ? { type: "log" } : { zero: false, padding: 12 }, axis: { tickCount: 6 } };
  const label = `${column.heading} over ${curve.quantity}`;
  return curveFigure(points_, x, column, label, "Cases differ in this property alone.", found.length > points_.length);
}

// The best solvers of the ranking, if there are too many to tell apart.
function keptSolvers(points_) {
  const names = [...new Set(points_.map(one => one.solver))];
  const best = [...new Set((boardShown()?.lines ?? []).map(line => solverOf(data.rows[line.row])))];
  const place = name => (best.includes(name) ? best.indexOf(name) : best.length);
  return names.sort((a, b) => place(a) - place(b)).slice(0, MOST_CURVES);
}

// A line needs values at four places; fewer are points side by side. Dashed lines come last, so that they hide no line under them.
function curveFigure(points_, x, column, label, caption, fewer) {
  const y = { field: "value", type: "quantitative", scale: { zero: false, padding: 10 }, title: column.heading };
  const counts = new Map();
  for (const one of points_) counts.set(one.entry, (counts.get(one.entry) ?? 0) + 1);
  const lined = points_.filter(one => counts.get(one.entry) >= LEAST_POINTS).sort((a, b) => DASHES.indexOf(a.dash) - DASHES.indexOf(b.dash));
  const layer = lined.length ? curveLayers(points_, lined, x, y) : sideBySide(points_, x, y);
  const drawing = plot({ height: 320, layer }, `${label}; the results say the same in numbers`);
  const shown_ = [...new Set(points_.map(one => one.solver))].sort(words.compare), best = (boardShown()?.lines ?? []).map(line => solverOf(data.rows[line.row]));
  const absent = [...new Set(best)].filter(solver => !shown_.includes(solver));
  const note = fewer ? ` The ${MOST_CURVES} best solvers are drawn.` : absent.length ? ` Without a value here: ${absent.join(", ")}.` : "";
  return make("figure", {}, drawing, legend(shown_, Boolean(lined.length)), plotDownloads(drawing, label,
      () => plottedRows(points_, column, "x", x.title)),
    make("figcaption", { class: "quiet" }, `${meant(column)} ${lined.length ? "Bands" : "Bars"} are 95 % confidence intervals over the seeds. ${caption}${note}`));
}

function curveLayers(points_, lined, x, y) {
  const shared = { detail: { field: "entry" }, color: LOOKS.color }, strokeDash = { field: "dash", type: "nominal", scale: null, legend: null };
  const banded = lined.filter(one => one.low !== null);
  return [
    ...(banded.length ? [{ data: { values: banded }, mark: { type: "area", opacity: 0.18 }, encoding: { x, y: { ...y, field: "low" }, y2: { field: "high" }, ...shared } }] : []),
    { data: { values: lined }, mark: { type: "line", strokeWidth: 2 }, encoding: { x, y, ...shared, strokeDash } },
    { data: { values: points_ }, mark: POINT, encoding: { x, y, ...LOOKS, ...TOLD } },
  ];
}

function sideBySide(points_, x, y) {
  const places = { field: "x", type: "ordinal", title: x.title, scale: GROUPED, axis: { labelAngle: 0 } };
  return points(points_, places, y, "y").map(one => ({ ...one, encoding: { ...one.encoding, xOffset: { field: "entry", type: "nominal" } } }));
}

// A score over the distance within which detections match, beside the single figure at one of them.

function toleranceSection(board) {
  if (!data.tasks[state.task].tolerance) return [];
  const rowsOf = column => byTask[state.task].filter(row => row.case === column.cases[0] && row.curve);
  const standardFirst = [...board.columns].sort((a, b) => (b.name === "standard") - (a.name === "standard"));
  const one = standardFirst.find(column => rowsOf(column).length);
  return one ? [make("h3", {}, `Score over the matching tolerance, ${one.name}`), tolerancePlot(rowsOf(one))] : [];
}

function tolerancePlot(rows) {
  const { heading, unit, distances } = data.tasks[state.task].tolerance;
  const column = { key: "", heading, decimals: 3, meaning: "share of pairs that are closer than the tolerance along every axis, as the harmonic mean of precision and recall" };
  const points_ = rows.flatMap(row => row.curve.map((score, place) => score && { ...plotted(row, score, column, ` within ${distances[place]} ${unit}`), x: distances[place], entry: row.id }).filter(Boolean));
  const kept = keptSolvers(points_);
  const x = { field: "x", type: "quantitative", title: `matching tolerance, ${unit}`, scale: { domain: [0, Math.max(...distances)] }, axis: { values: [0, ...distances] } };
  return curveFigure(points_.filter(one => kept.includes(one.solver)), x, column, `${heading} over the matching tolerance`,
    "A solver that finds particles but places them badly falls off to the left; the table’s figure is one point of this curve.", kept.length < new Set(points_.map(one => one.solver)).size);
}
