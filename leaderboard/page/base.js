// The page's script: its files are joined in the order of sabench/evaluation/leaderboard/page.py.
// No text of a record becomes markup, a style or code: it is only ever a text node, an attribute of a fixed name, or a value in a plot's data.
// Where the browser can, it holds everyone to that, the plotting library, too, which empties its element by way of markup.
globalThis.trustedTypes?.createPolicy("default", { createHTML: text => (text === "" ? "" : null) });
const data = JSON.parse(document.getElementById("data").textContent);
const DASH = "–";
const PROCESS = "†";  // next to the seconds of a program
const PROCESS_TEXT = `${PROCESS} marks the seconds of a program: they are those of its whole process, with its start and the reading and writing of files, which the seconds of a plug-in leave out.`;

function textOf(place) {
  return data.texts[place];
}

function fixed(value, decimals) {
  return value.toFixed(decimals).replace(/^-(0(\.0*)?)$/, "$1");
}

// "0.750 ± 0.004" of [mean, half width], or the mean alone.
function shown(score, decimals) {
  if (!score) return DASH;
  return fixed(score[0], decimals) + (score.length > 1 ? ` ± ${fixed(score[1], decimals)}` : "");
}

function listed(texts, empty = DASH) {
  return texts.length ? texts.join(", ") : empty;
}

// Mean and half width of the 95 % confidence interval, as sabench/utils/confidence.py has them: [mean] of one value, null of none.
function meanOf(values) {
  const count = values.length;
  if (!count) return null;
  const mean = values.reduce((sum, value) => sum + value, 0) / count;
  if (count === 1) return [mean];
  const squares = values.reduce((sum, value) => sum + (value - mean) ** 2, 0);
  const quantile = data.quantiles[Math.min(count - 1, data.quantiles.length) - 1];
  return [mean, quantile * Math.sqrt(squares / (count - 1) / count)];
}

// A text with a mark of its colour before the first of each of the words found, missed, ghost and duplicate.
function keyed(text) {
  const seen = new Set();
  return text.split(/\b(?=(?:found|missed|ghost|duplicate):)/i).flatMap(part => {
    const kind = part.match(/^\w+(?=:)/)?.[0].toLowerCase();
    if (!Object.hasOwn(data.kinds, kind ?? "") || seen.has(kind)) return [part];
    const mark = make("span", { class: "kind", "aria-hidden": "true" });
    mark.style.background = data.kinds[kind];
    seen.add(kind);
    return [make("span", { class: "key" }, mark, part.slice(0, kind.length)), part.slice(kind.length)];
  });
}

function selector(label, value, options, change) {
  const own = make("select", { change: event => change(event.target.value) });
  for (const [key, text] of options) own.append(make("option", { value: key, selected: key === value }, text));
  return make("label", {}, make("span", {}, label), own);
}

async function copy(text, button) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    const field = make("textarea", { readonly: true, class: "unseen" });
    field.value = text;
    document.body.append(field);
    field.select();
    document.execCommand("copy");
    field.remove();
    button.focus();
  }
  const before = button.textContent;
  button.textContent = "copied";
  setTimeout(() => { button.textContent = before; }, 1500);
}

function copyButton(text) {
  const button = make("button", { type: "button", class: "copy", title: text, "aria-label": `copy the command ${text}`, click: () => copy(text, button) }, "copy");
  return button;
}

function command(text) {
  return make("div", { class: "command" }, make("code", {}, text), copyButton(text));
}

// Act when the whole file is there: figures and the plotting library come after this script.
function whenLoaded(act) {
  if (document.readyState === "loading") addEventListener("DOMContentLoaded", act, { once: true });
  else act();
}
