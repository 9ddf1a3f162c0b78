// The table: a page of rows at a time, so that ten thousand records make no more elements than fifty.
const PAGE = 25;
const CODE_TEXT = "Code: the first digits of a hash of the measured solver's sources; the details have all of them.";
const open = new Set();  // ids of rows whose details are shown

function columnsOf(rows) {
  const { columns: all, main: first } = data.tasks[state.task];
  const columns = all.map((column, place) => ({ ...column, place }));
  const wanted = state.all || oneCase() ? columns : columns.filter((column, place) => place < first || place >= columns.length - 2);
  return wanted.filter(column => column.place === 0 || rows.some(row => row.scores[column.place]));  // not every case has every figure
}

function heading(key, text, number, title) {
  const falling = state.sort.startsWith("-"), own = state.sort.replace(/^-/, "") === key;
  const order = own ? (falling ? "descending" : "ascending") : null;
  const press = () => { filter({ sort: order === "ascending" ? `-${key}` : key }); document.querySelector(`th[data-key="${key}"] button`).focus(); };
  return make("th", { scope: "col", "data-key": key, "aria-sort": order, class: number ? "number" : null },
    make("button", { type: "button", title, click: press }, text));
}

function heads(columns) {
  return make("tr", {},
    heading("solver", "solver"), oneCase() ? null : heading("case", "case"), graded() ? heading("difficulty", "difficulty") : null, heading("seeds", "seeds", true), heading("date", "measured"),
    columns.map(column => heading(column.key, column.heading, true, column.meaning)),
    heading("machine", "machine"), make("th", { scope: "col", class: "plain" }, "reproduce"), make("th", { scope: "col", class: "plain" }, "details"));
}

function chips(row) {
  const own = caseOf(row);
  return [
    own.recorded && make("span", { class: "chip", title: "real cameras took the images: figures without truth judge the results, and none is ranked" }, "recorded, no truth"),
    own.split === "hidden" && make("span", { class: "chip hidden" }, "hidden split"),
    row.submission && make("span", { class: "chip" }, `by ${row.submission.name}`),
    row.open && make("span", { class: "chip", title: "the solver could have read the truth: this machine could not confine it" }, "not isolated"),
  ];
}

// A name that may go to the next line after an underscore.
function wrapped(name) {
  return (name.match(/[^_]*_|[^_]+/g) ?? []).flatMap((part, place) => (place ? [make("wbr"), part] : [part]));
}

function solverCell(row) {
  const parameters = alone(row) ? "" : textOf(row.parameters);  // others are in the details
  return make("th", { scope: "row" }, make("span", { class: "name" }, wrapped(solverOf(row))), chips(row),
    parameters && make("span", { class: "quiet few clamp", title: parameters }, parameters));
}

// Whether a solver has no other row of the same case.
function alone(row) {
  row.twins ??= byTask[caseOf(row).task].filter(one => one.case === row.case && one.solver === row.solver).length;
  return row.twins === 1;
}

function scoreCells(row, columns) {
  if (row.error) {
    const word = row.declined ? "declined: " : "failed: ";
    return [make("td", { class: row.declined ? "error quiet" : "error", colspan: columns.length }, word + row.error)];
  }
  return columns.map(column => make("td", { class: "number score", "data-label": column.heading }, scoreWords(row, column)));
}

// A score, marked where it is not measured as others are.
function scoreWords(row, column) {
  return shown(row.scores[column.place], column.decimals) + (column.key === "seconds" && row.wholeProcess && row.scores[column.place] ? ` ${PROCESS}` : "");
}

function lineOf(row, columns) {
  const own = caseOf(row);
  const line = make("tr", { class: row.error ? "failed" : null },
    solverCell(row),
    oneCase() ? null : make("td", { class: "words", "data-label": "case" }, make("a", { href: link({ view: "case", case: own.id, sort: "", page: "1", a: "", b: "" }) }, own.name)),
    graded() ? make("td", { "data-label": "difficulty" }, own.difficulty ?? DASH, own.axis && make("span", { class: "quiet few" }, own.axis)) : null,
    make("td", { class: "number", "data-label": "seeds" }, String(row.seeds.length)),
    make("td", { "data-label": "measured", class: "date" }, dateOf([row]) || DASH, make("span", { class: "quiet few" }, versionOf([row]))),
    scoreCells(row, columns),
    make("td", { class: "words", "data-label": "machine" }, textOf(row.machine) || DASH),
    make("td", { "data-label": "reproduce" }, row.commands.length ? copyButton(textOf(row.commands[0])) : DASH),
    make("td", { "data-label": "details" }, detailsButton(row)));
  return line;
}

function oneCase() {
  return state.view === "case";
}

// Whether there is a column of difficulties: a task need not have any, and all rows of a case have the same.
function graded() {
  return !oneCase() && data.cases.some(own => own.task === state.task && (own.difficulty || own.axis));
}

function detailsButton(row) {
  const button = make("button", { type: "button", class: "small", "aria-expanded": String(open.has(row.id)), "aria-label": `details of ${solverOf(row)}` }, "details");
  button.addEventListener("click", () => {
    const line = button.closest("tr"), was = open.has(row.id);
    if (was) line.nextElementSibling.remove();
    else line.after(detailsOf(row, line));
    open[was ? "delete" : "add"](row.id);
    button.setAttribute("aria-expanded", String(!was));
  });
  return button;
}

function terms(pairs) {
  const known = pairs.filter(([, value]) => value !== null && value !== undefined && value !== "");
  return make("dl", {}, known.map(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]));
}

function detailsOf(row, line) {
  const own = caseOf(row);
  const runs = row.seeds.map((seed, i) => make("li", {}, `seed ${seed}: data set ${textOf(row.datasets[i])}, run ${row.runs[i]}`));
  const facts = terms([
    ["reproduce", row.commands.length ? row.commands.map(place => command(textOf(place))) : "this record does not say by which command it was made"],
    ["solver", textOf(row.name)], ["parameters", textOf(row.parameters) || "its defaults, unnamed"],
    ["submission", row.submission && `${row.submission.name}, ${row.submission.date}`],
    ["same estimates as", row.twin],
    ...Object.entries(row.card ?? {}).filter(([key]) => key !== "solver").map(([key, text]) => [key === "parameters" ? "parameters selected" : key.replaceAll("_", " "), text]),
    ["case", listed([own.suite && `suite ${own.suite}`, own.recorded ? "recorded" : `scene ${own.scene}`, own.axes, !own.recorded && `renderer ${own.renderer}`, `${own.split} split`].filter(Boolean))],
    [own.recorded ? "data set" : "scene hash", own.hash], ["machine", textOf(row.machineAll)], ["versions", textOf(row.versions)],
    ["code hash", listed(row.codes.map(textOf), "")],
    ["measured", dateOf([row])], ["reference time", row.reference && `${row.reference} s in the same run`], ["runs", make("ul", {}, runs)],
  ]);
  const across = [...line.cells].reduce((sum, cell) => sum + cell.colSpan, 0);
  return make("tr", { class: "details" }, make("td", { colspan: across }, make("div", { class: "inner" }, facts)));
}

// The table of these rows in a box that scrolls sideways by itself.
function tableOf(rows, label, all = rows) {
  const columns = columnsOf(all);
  const body = make("tbody");
  for (const row of rows) {
    const line = lineOf(row, columns);
    body.append(line);
    if (open.has(row.id)) body.append(detailsOf(row, line));
  }
  return make("div", { class: "box", role: "region", "aria-label": label, tabindex: "0" },
    make("table", { class: "cards" }, make("caption", { class: "unseen" }, label), make("thead", {}, heads(columns)), body));
}

function pager(count) {
  const pages = Math.max(1, Math.ceil(count / PAGE)), page = pageOf(count);
  if (pages === 1) return null;
  const turn = (text, to, name) => make("button", {
    type: "button", "data-turn": name, disabled: to < 1 || to > pages,
    click: () => { change({ page: String(to) }); document.querySelector(`[data-turn="${name}"]:not(:disabled)`)?.focus(); },
  }, text);
  return make("nav", { class: "pager", "aria-label": "Pages of the table" },
    turn("first", page > 1 ? 1 : 0, "first"), turn("previous", page - 1, "previous"), make("span", {}, `page ${page} of ${pages}`),
    turn("next", page + 1, "next"), turn("last", page < pages ? pages : pages + 1, "last"));
}

function pageOf(count) {
  const asked = Math.floor(Number(state.page)) || 1;
  return Math.min(Math.max(1, asked), Math.max(1, Math.ceil(count / PAGE)));
}

function tableView(rows) {
  const sorted = ordered(rows), first = (pageOf(rows.length) - 1) * PAGE;
  const label = `Results of the task ${taskName(state.task)}`;
  const save_ = downloads(oneCase() ? label : `results of ${state.task}`, () => sorted.map(logRow));
  return [sortChoice(rows), tableOf(sorted.slice(first, first + PAGE), label, rows), pager(rows.length), rows.length ? save_ : null, legendOfColumns(rows)];
}

// On a narrow screen the table has no headings that could be pressed.
function sortChoice(rows) {
  const keys = columnsOf(rows).flatMap(column => [[column.key, `${column.heading}, rising`], [`-${column.key}`, `${column.heading}, falling`]]);
  return make("div", { class: "form narrow" }, selector("Order", state.sort, [["", "by case and rank"], ["solver", "solver"], ...keys], sort => filter({ sort })));
}

// A result as a line of a file: everything that the table could show.
function logRow(row) {
  const own = caseOf(row), { columns } = data.tasks[state.task];
  const scores = columns.flatMap((column, place) => [[column.key, row.scores[place]?.[0] ?? ""], [`${column.key} half width`, row.scores[place]?.[1] ?? ""]]);
  return { solver: solverOf(row), parameters: textOf(row.parameters), by: row.submission?.name ?? "", case: own.name, suite: own.suite ?? "", difficulty: own.difficulty ?? "", axis: own.axis ?? "",
    split: own.split, seeds: row.seeds.join(" "), ...Object.fromEntries(scores), ranked: String(row.ranked), error: row.error ?? "", measured: dateOf([row]), machine: textOf(row.machine), command: row.commands.map(textOf).join("; ") };
}

function legendOfColumns(rows) {
  return make("details", { class: "meaning" }, make("summary", {}, "What the columns mean"),
    terms(columnsOf(rows).map(column => [column.heading, column.meaning])),
    make("p", { class: "quiet" }, "Over several seeds a score is the mean ± half the width of its 95 % confidence interval. "
      + "Cases come in the order of their names and the best of each first, until a heading sorts them: once for rising, twice for falling. Results without a rank and failed ones stay last. "
      + (rows.some(row => row.wholeProcess) ? `${PROCESS_TEXT} ` : "") + `${CODE_TEXT} `
      + `${DASH} stands for a score that does not apply. ${data.tasks[state.task].gate}`));
}
