// Files of what is shown. A spreadsheet must not take a record's text for a formula, nor TeX for a command.
function save(name, type, content) {
  const url = URL.createObjectURL(new Blob([content], { type }));
  const link_ = make("a", { href: url, download: name });
  link_.click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}

const TEX = { "\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}", "±": "$\\pm$", "–": "--", "†": "$\\dagger$", "×": "$\\times$", "≥": "$\\ge$", "≤": "$\\le$" };

function csvCell(value) {
  const text = String(value ?? "");
  const safe = typeof value === "string" && /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\r\n]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
}

function texCell(value) {
  return String(value ?? "").replace(/[\\~^±–†×≥≤]|[&%$#_{}]/g, one => TEX[one] ?? `\\${one}`).replace(/[\r\n]+/g, " ");
}

// `rows` are objects of equal keys; the first row's keys are the headings.
const FORMATS = {
  CSV: ["csv", "text/csv", rows => [Object.keys(rows[0]), ...rows.map(Object.values)].map(row => row.map(csvCell).join(",")).join("\r\n") + "\r\n"],
  JSON: ["json", "application/json", rows => JSON.stringify(rows, null, 1) + "\n"],
  LaTeX: ["tex", "application/x-tex", rows => {
    const heads = Object.keys(rows[0]), line = cells => `${cells.map(texCell).join(" & ")} \\\\`;
    return [`\\begin{tabular}{${"l".repeat(heads.length)}}`, "\\hline", line(heads), "\\hline", ...rows.map(row => line(Object.values(row))), "\\hline", "\\end{tabular}", ""].join("\n");
  }],
};

function fileName(stem, ending) {
  return `sabench-${stem.toLowerCase().replace(/[^a-z0-9.]+/g, "-").replace(/^-|-$/g, "").slice(0, 80)}.${ending}`;
}

// Buttons that save rows, which are made when one is pressed.
function saveButtons(stem, rows) {
  return Object.entries(FORMATS).map(([name, [ending, type, format]]) => make("button", {
    type: "button", class: "small", "aria-label": `save ${stem} as ${name}`,
    click: () => { const made = rows(); if (made.length) save(fileName(stem, ending), type, format(made)); },
  }, name));
}

function downloads(stem, rows) {
  return make("p", { class: "saves" }, "Save as ", saveButtons(stem, rows));
}

// Buttons that save a drawn plot, and its numbers.
function plotDownloads(place, stem, rows) {
  const vector = async () => save(fileName(stem, "svg"), "image/svg+xml", await place.view.view.toSVG());
  const pixels = async () => {
    const canvas = await place.view.view.toCanvas(2);
    canvas.toBlob(blob => save(fileName(stem, "png"), "image/png", blob), "image/png");
  };
  const buttons = Object.entries({ SVG: vector, PNG: pixels }).map(([name, press]) => make("button", {
    type: "button", class: "small", "aria-label": `save the plot ${stem} as ${name}`, click: () => { if (place.view) press(); },
  }, name));
  return make("p", { class: "saves" }, "Save as ", buttons, saveButtons(stem, rows));
}
