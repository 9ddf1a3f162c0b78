// What is shown, kept in the URL's fragment, so that a view can be linked.
const DEFAULTS = {
  task: Object.keys(data.tasks)[0] ?? "", view: "front", q: "", difficulty: "", axis: "", solver: "", split: "",
  sort: "", page: "1", all: "", case: "", a: "", b: "", x: "seconds", y: "", group: "", curve: "", left: "", right: "",
};
const OF_A_TASK = ["axis", "solver", "sort", "page", "case", "a", "b", "y", "group", "curve", "left", "right", "all"];  // what another task makes meaningless
const OF_THE_LOG = ["q", "difficulty", "axis", "solver", "split", "sort", "page"];
const VIEWS = { front: "Ranking", table: "All results", time: "Accuracy against time", why: "Difficulty and axes" };
let state = read();

function read() {
  const found = new URLSearchParams(location.hash.slice(1));
  const next = Object.fromEntries(Object.entries(DEFAULTS).map(([key, value]) => [key, found.get(key) ?? value]));
  if (!Object.hasOwn(data.tasks, next.task)) next.task = found.get("track") ?? "";  // links of earlier pages
  if (!Object.hasOwn(data.tasks, next.task)) next.task = DEFAULTS.task;
  if (!found.has("view") && OF_THE_LOG.some(key => found.has(key))) next.view = "table";  // links of earlier pages
  if (!Object.hasOwn(VIEWS, next.view) && next.view !== "case") next.view = DEFAULTS.view;
  return next;
}

// The fragment of this view with changes: defaults are left out.
function link(changes) {
  const next = { ...state, ...changes };
  const parts = Object.entries(next).filter(([key, value]) => value !== DEFAULTS[key]);
  return "#" + new URLSearchParams(parts);
}

function otherTask(task) {
  return link({ ...Object.fromEntries(OF_A_TASK.map(key => [key, DEFAULTS[key]])), task, view: state.view === "case" ? "front" : state.view });
}

// Change the view: filters replace the history's entry, so that "back" leaves a view and not a letter.
function change(changes) {
  history.replaceState(null, "", link(changes));
  state = read();
  render();
}

function filter(changes) {
  change({ page: "1", ...changes });
}
