// Which rows are shown, and in which order. The data's own order is by case, the best of each first.
const words = new Intl.Collator("en", { numeric: true });
const DIFFICULTIES = ["easy", "standard", "hard"];
data.rows.forEach((row, place) => { row.place = place; });
const byTask = Object.fromEntries(Object.keys(data.tasks).map(task => [task, data.rows.filter(row => caseOf(row).task === task)]));

function caseOf(row) {
  return data.cases[row.case];
}

function solverOf(row) {
  return textOf(row.solver);
}

function searched(row) {
  if (row.searched === undefined) {
    const own = caseOf(row);
    const texts = [own.name, own.scene, own.suite, own.axes, own.axis, solverOf(row), textOf(row.name), textOf(row.parameters), row.submission?.name, textOf(row.machine)];
    row.searched = texts.filter(Boolean).join(" ").toLowerCase();
  }
  return row.searched;
}

function chosen() {
  const wanted = state.q.toLowerCase().split(/\s+/).filter(Boolean);
  return byTask[state.task].filter(row => {
    const own = caseOf(row);
    return (!state.difficulty || own.difficulty === state.difficulty)
      && (!state.axis || (state.axis === "-" ? !own.axis : own.axis === state.axis))
      && (!state.split || own.split === state.split)
      && (!state.solver || solverOf(row) === state.solver)
      && wanted.every(word => searched(row).includes(word));
  });
}

function scoreOf(row, key) {
  const place = data.tasks[caseOf(row).task].columns.findIndex(column => column.key === key);
  return place < 0 ? null : row.scores[place];
}

const SORTED_BY = {
  solver: solverOf, date: row => dateOf([row]), machine: row => textOf(row.machine), case: row => row.case, seeds: row => row.seeds.length,
  difficulty: row => { const place = DIFFICULTIES.indexOf(caseOf(row).difficulty); return place < 0 ? null : place; },
};

function ordered(rows) {
  const falling = state.sort.startsWith("-"), key = state.sort.replace(/^-/, "");
  if (!key) return rows;
  const score = !Object.hasOwn(SORTED_BY, key);
  const place = data.tasks[state.task].columns.findIndex(column => column.key === key);
  if (score && place < 0) return rows;
  const valued = rows.map(row => ({ row, value: score ? row.scores[place]?.[0] ?? null : SORTED_BY[key](row) }));
  // at the end either way: rows without a rank, whose scores may be good by what they leave out, then failed runs; in each group, no number
  const last = ({ row, value }) => (row.error ? 4 : row.ranked ? 0 : 2) + (value === null ? 1 : 0);
  const by = (a, b) => (a === null ? 0 : typeof a === "string" ? words.compare(a, b) : a - b);
  valued.sort((a, b) => last(a) - last(b) || (falling ? -1 : 1) * by(a.value, b.value) || a.row.place - b.row.place);
  return valued.map(one => one.row);
}

// When and with which code rows were measured: "2026-11-26 to 2026-12-01", "sabench 0.1.0, code 1a2b3c4d".
function dateOf(rows) {
  const dates = [...new Set(rows.map(row => row.date || row.submission?.date).filter(Boolean))].sort();
  return dates.length > 1 ? `${dates[0]} to ${dates.at(-1)}` : dates[0] ?? "";
}

function versionOf(rows) {
  const versions = values(rows, row => textOf(row.versions).match(/(?:^|, )(sabench [^,]+)/)?.[1]);
  const codes = [...new Set(rows.flatMap(row => row.codes.map(textOf)))];
  return [...versions, codes.length > 2 ? `${codes.length} versions of the code` : codes.length && `code ${codes.map(code => code.slice(0, 8)).join(" and ")}`].filter(Boolean).join(", ");
}

// Bundled solvers of a task that have none of these rows.
function unmeasured(rows) {
  const names = new Set(rows.map(row => textOf(row.name))), task = state.task.replace(", recorded", "");
  return data.solvers.filter(([group, name]) => group === task && !names.has(name)).map(([, name]) => name);
}

function unmeasuredNote(rows, where) {
  const names = unmeasured(rows);
  return names.length ? make("p", { class: "quiet unmeasured" }, `Not measured ${where}: ${names.join(", ")}.`) : null;
}

function values(rows, of) {
  return [...new Set(rows.map(of).filter(Boolean))].sort(words.compare);
}
