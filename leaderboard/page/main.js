// What belongs together on the screen: tasks, filters, views.
const main = document.getElementById("main");
const part = Object.fromEntries(["filters", "views", "status", "content"].map(name => [name, make(name === "views" ? "nav" : "div", { id: name })]));
let drawn = {};  // the state of the last drawing

function taskName(task) {
  return task.replace("_", " ");
}

function tasksBar() {
  const links = Object.keys(data.tasks).map(task => make("a", { href: otherTask(task), "aria-current": task === state.task ? "page" : null },
    taskName(task), make("span", { class: "count" }, String(byTask[task].length))));
  document.getElementById("tasks").replaceChildren(...links);
}

function viewsBar() {
  const shownView = state.view === "case" ? "" : state.view;
  const links = Object.entries(VIEWS).map(([view, name]) => make("a", { href: link({ view, case: view === "time" ? state.case : "", a: "", b: "" }), "aria-current": view === shownView ? "page" : null }, name));
  part.views.setAttribute("aria-label", "Views");
  part.views.replaceChildren(...links);
}

function filtersOf() {
  const rows = byTask[state.task], some = (label, options) => [["", `all ${label}`], ...options.map(option => [option, option])];
  const search = make("input", { type: "search", value: state.q, placeholder: "words of case, scene, solver", input: event => filter({ q: event.target.value }) });
  const axes = values(rows, row => caseOf(row).axis);
  const difficulties = DIFFICULTIES.filter(one => rows.some(row => caseOf(row).difficulty === one));
  const splits = values(rows, row => caseOf(row).split);
  return make("form", { class: "form", role: "search", "aria-label": "Filters", submit: event => event.preventDefault() },
    make("label", { class: "search" }, make("span", {}, "Search"), search),
    selector("Solver", state.solver, some("solvers", values(rows, solverOf)), solver => filter({ solver })),
    difficulties.length ? selector("Difficulty", state.difficulty, some("difficulties", difficulties), difficulty => filter({ difficulty })) : null,
    axes.length ? selector("Axis", state.axis, [["", "all axes"], ["-", "none"], ...axes.map(axis => [axis, axis])], axis => filter({ axis })) : null,
    splits.length > 1 ? selector("Split", state.split, some("splits", splits), split => filter({ split })) : null,
    make("label", { class: "tick" }, make("input", { type: "checkbox", checked: state.all === "1", change: event => change({ all: event.target.checked ? "1" : "" }) }), make("span", {}, "all scores")),
    make("button", { type: "button", click: () => { change({ q: "", solver: "", difficulty: "", axis: "", split: "", page: "1" }); drawFilters(); } }, "clear"));
}

function drawFilters() {
  part.filters.replaceChildren(filtersOf());
}

function render() {
  const before = drawn, top = main.querySelector(".box")?.scrollLeft ?? 0;
  drawn = { ...state };
  document.getElementById("tip")?.remove();
  tasksBar();
  viewsBar();
  if (before.task !== state.task || before.moved) drawFilters();
  part.filters.hidden = state.view === "case" || state.view === "front";
  part.filters.dataset.view = state.view;
  const rows = chosen();
  part.status.textContent = part.filters.hidden ? "" : `${rows.length} of ${byTask[state.task].length} results`;
  const views = { front: frontView, table: () => tableView(rows), time: () => timeView(rows), why: () => whyView(rows), case: caseView };
  part.content.replaceChildren(...views[state.view]().filter(Boolean));
  if (before.view === state.view && before.task === state.task) main.querySelector(".box")?.scrollTo(top, 0);
}

// Another fragment: a link was followed, or the history was walked.
function moved() {
  const before = state;
  state = read();
  drawn.moved = true;
  render();
  if (before.view !== state.view || before.case !== state.case) {
    scrollTo(0, 0);
    (part.content.querySelector("h2") ?? main).focus({ preventScroll: true });
  }
}

function start() {
  document.querySelector(".skip").addEventListener("click", () => main.focus());
  if (!data.rows.length) {
    main.replaceChildren(make("p", {}, "There are no records yet: ", make("code", {}, "sabench run quick"), " makes the first."));
    return;
  }
  part.status.setAttribute("role", "status");
  main.replaceChildren(part.views, part.filters, part.status, part.content);
  render();
  requestAnimationFrame(() => setTimeout(() => performance.mark("first row")));  // when it is on the screen: benchmarks/page.py reads it
  addEventListener("hashchange", moved);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", render);
}

// The tables need no more than what is above this script; pictures and the library come after it.
main.replaceChildren();
if (state.view === "front" || state.view === "table" || !data.rows.length) start();
else addEventListener("DOMContentLoaded", start);
