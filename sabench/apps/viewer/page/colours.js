// Colours of the theme, and shapes of the kinds: colours that the colour-blind can distinguish, and a shape for each.
const colours = {};
const THEME = ["page", "stage", "text", "quiet", "rig", "chosen", "glass", "light", "solid", ...KINDS];

function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of THEME) colours[name] = style.getPropertyValue(`--${name}`).trim();
}
readColours();

// Viridis, for speeds: dark to bright, also without colours. The end that the background hides is left out.
const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
const dark = matchMedia("(prefers-color-scheme: dark)");
function ramp(share) {
  const [first, last] = dark.matches ? [.25, 1] : [0, .85], seen = first + Math.min(Math.max(share, 0), 1) * (last - first);
  const at = seen * (RAMP.length - 1), low = Math.min(Math.floor(at), RAMP.length - 2);
  return RAMP[low].map((value, i) => (value + (RAMP[low + 1][i] - value) * (at - low)) / 255);
}

// Outline of a kind's mark, centred, of radius r: ring, disc, diamond, cross, triangle.
function markPath(context, kind, x, y, r) {
  if (kind === "true") { context.moveTo(x + r, y); context.arc(x, y, r, 0, 2 * Math.PI); }
  else if (kind === "found") { context.moveTo(x + .75 * r, y); context.arc(x, y, .75 * r, 0, 2 * Math.PI); }
  else if (kind === "missed") { context.moveTo(x, y - r); context.lineTo(x + r, y); context.lineTo(x, y + r); context.lineTo(x - r, y); context.closePath(); }
  else if (kind === "ghost") { const d = .8 * r; context.moveTo(x - d, y - d); context.lineTo(x + d, y + d); context.moveTo(x - d, y + d); context.lineTo(x + d, y - d); }
  else { context.moveTo(x, y - r); context.lineTo(x + .9 * r, y + .7 * r); context.lineTo(x - .9 * r, y + .7 * r); context.closePath(); }
}

function icon(kind, round = false) {
  const canvas = make("canvas", { width: 36, height: 36, "aria-hidden": "true" });
  canvas.style.width = canvas.style.height = "18px";
  const draw = () => {
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, 36, 36);
    context.lineWidth = 4.5;
    context.strokeStyle = context.fillStyle = colours[kind];
    context.beginPath();
    if (round) context.arc(18, 18, 14, 0, 2 * Math.PI); else markPath(context, kind, 18, 18, 13);
    if (kind === "found" || ALONE || (round && kind !== "missed")) context.fill(); else context.stroke();
  };
  draw();
  listeners.push(what => { if (what.has("theme")) draw(); });
  return canvas;
}
