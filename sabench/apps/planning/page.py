"""Page of a plan: warnings, drawings of the rig and figures, as one HTML file."""

import numpy as np
from markupsafe import Markup

from sabench.apps.planning.plan import Plan
from sabench.apps.viewer.outlines import OUTLINE_KINDS, STYLE
from sabench.apps.viewer.surroundings import Surroundings, draw_surroundings
from sabench.plotting.page import render_page
from sabench.scenes.build import build_walls


def draw_rig(plan: Plan) -> list[tuple[str, str]]:
    """Draw a rig and its volume as pairs of a title and an SVG element."""
    grid, cameras = plan.rig.grid, plan.rig.cameras
    scored = np.array(grid.scored_box_mm)
    walls, light = build_walls(plan.scene.wall), plan.scene.illumination
    around = Surroundings(cameras, *grid.box_mm, scored, light, faces=walls)
    wholes, volumes = draw_surroundings(around), draw_surroundings(around, near=True)
    return [drawing for pair in zip(wholes, volumes, strict=True) for drawing in pair]


_NAMES = {
    "sheet": "light",
    "volume": "volume",
    "wall": "faces of the wall",
    "ray": "lines of sight: corners of the images",
    "camera": "cameras",
}

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Plan: {{ title }}</title>
<style>
{{ style }}
:root { color-scheme: light dark;
        --page: #fff; --text: #1b1f24; --line: #d5dae0; --shade: #eef1f4; }
@media (prefers-color-scheme: dark) {
  :root { --page: #0d1117; --text: #e6edf3; --line: #2d3640; --shade: #1c242d; }
}
@media print { :root { --page: #fff; --text: #000; } figure, tr { break-inside: avoid; } }
body { font: 15px/1.45 system-ui, sans-serif; color: var(--text); background: var(--page);
       margin: 1.5em auto; max-width: 1180px; padding: 0 1em; overflow-wrap: anywhere; }
h1 { font-size: 1.35em; } h2 { font-size: 1.1em; margin-top: 1.6em; }
.drawings { display: flex; flex-wrap: wrap; gap: 1.2em; }
figure { margin: 0; } figcaption { font-weight: bold; margin-bottom: 0.3em; }
svg.drawing { max-width: 100%; height: auto; }
svg text, .camera { fill: currentColor; } .frame { fill: none; stroke: var(--line); }
.camera, .scale { stroke: currentColor; } .ray { stroke: #2f8fd0; stroke-opacity: 0.6; }
table { border-collapse: collapse; width: 100%; }
td, th { text-align: left; padding: 0.15em 0.7em 0.15em 0; border-bottom: 1px solid var(--line); }
td.value { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
code { background: var(--shade); padding: 0 0.2em; }
@media (max-width: 40em) { td:last-child, th:last-child { display: none; } }
.warnings li { margin: 0.3em 0; }
.legend svg { vertical-align: middle; } .legend span { margin-right: 1.4em; }
</style>
</head>
<body><main>
<h1>{{ title }}</h1>
<h2>Warnings</h2>
{% if advice %}
<ul class="warnings">
{% for one in advice %}
<li><code>{{ one.key }}</code>: {{ one.sentence }}</li>
{% endfor %}
</ul>
{% else %}
<p>None.</p>
{% endif %}
<h2>Rig</h2>
<p class="legend">
{% for kind, name in legend %}
<span><svg width="22" height="14">
<rect class="{{ kind }}" x="2" y="2" width="18" height="10"/>
</svg> {{ name }}</span>
{% endfor %}
</p>
<div class="drawings">
{% for name, drawing in drawings %}
<figure><figcaption>{{ name }}</figcaption>
{{ drawing }}
</figure>
{% endfor %}
</div>
{% for section in sections %}
<h2>{{ section.title | capitalize }}</h2>
<table>
<tr><th>figure</th><th>value</th><th>meaning</th><th>equation or source</th></tr>
{% for one in section.quantities %}
<tr><td><code>{{ one.key }}</code></td><td class="value">{{ one.text }}</td>
<td>{{ one.meaning }}</td><td>{{ one.source }}</td></tr>
{% endfor %}
</table>
{% endfor %}
<p>Numbers in brackets are equations of J. Belden, Synthetic Aperture Imaging for Three Dimensional
Resolution of Fluid Flows, MIT.</p>
</main></body>
</html>
"""


def render_plan(plan: Plan) -> str:
    """Render a plan as a self-contained page."""
    values = {
        "title": plan.scene.title,
        "advice": plan.advice,
        "drawings": [(name, Markup(svg)) for name, svg in draw_rig(plan)],
        "sections": plan.sections,
        "legend": [(kind, _NAMES[kind]) for kind in reversed(OUTLINE_KINDS)],
        "style": Markup(STYLE),
    }
    return render_page(_PAGE, values)
