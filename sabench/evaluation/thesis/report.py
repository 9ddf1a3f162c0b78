"""Page of reproduced tables and figures, with curves beside the values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import Any

from sabench.plotting.page import render_page
from sabench.utils.number_text import significant

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Reproduction of the thesis</title>
<style>
body { font: 15px/1.45 sans-serif; color: #000; background: #fff; margin: 1.5em auto;
       max-width: 1280px; padding: 0 1em; }
h1 { font-size: 1.35em; } h2 { font-size: 1.1em; margin-top: 2em; }
.item { display: flex; flex-wrap: wrap; gap: 1.2em; align-items: flex-start; }
.rows { flex: 1 1 560px; overflow-x: auto; }
.curves { flex: 1 1 420px; margin: 0; }
.curves img { max-width: 100%; height: auto; border: 1px solid #ddd; }
table { border-collapse: collapse; width: 100%; }
td, th { text-align: left; padding: 0.15em 0.6em; border-bottom: 1px solid #ddd;
         vertical-align: top; }
td.value { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td.note { color: #444; font-size: 0.9em; }
.good { color: #00573a; font-weight: bold; }
.bad { color: #a11000; font-weight: bold; }
</style>
</head>
<body>
<h1>Reproduction of the thesis</h1>
<p>The thesis is J. Belden, Synthetic Aperture Imaging for Three Dimensional Resolution of Fluid
Flows, MIT. Values are means over seeds, with half widths of 95 % confidence intervals.
{% if small %}<strong>Images were smaller than the scenes': values are not comparable.</strong>
{% endif %}</p>
<h2>All tables and figures</h2>
<div class="rows"><table>
<tr><th>name</th><th>what it shows</th><th>verdict</th><th>measured by</th></tr>
{% for one in entries %}
<tr><td>{{ one.name }}</td><td>{{ one.shows }}</td>
<td class="{{ one.verdict | grade }}">{{ one.verdict }}</td>
<td>{% if one.item in items %}<a href="#{{ one.item }}">{{ one.item }}</a>
{% else %}{{ one.item }}{% endif %}</td></tr>
{% endfor %}
</table></div>
{% for name, rows in items.items() %}
<h2 id="{{ name }}">{{ name }}: {{ titles[name] }}</h2>
<div class="item">
<div class="rows"><table>
<tr><th>row</th><th>thesis</th><th>ours</th><th>seeds</th><th>verdict</th></tr>
{% for row in rows %}
<tr><td>{{ row.name }}</td><td class="value">{{ row.thesis | value }}</td>
<td class="value">{{ row.measured | value }}{{ row.ci95 | interval }}</td>
<td class="value">{{ row.seeds or "-" }}</td>
<td class="{{ row.verdict | grade }}">{{ row.verdict }}</td></tr>
{% if row.note %}<tr><td class="note" colspan="5">{{ row.note }}</td></tr>{% endif %}
{% endfor %}
</table></div>
{% for plot in plots.get(name, []) %}
<figure class="curves"><img src="{{ plot.name }}.png" alt="{{ plot.title }}"></figure>
{% endfor %}
</div>
{% endfor %}
</body>
</html>
"""


def render(
    entries: Sequence[Mapping[str, str]],
    rows: Sequence[Mapping[str, Any]],
    titles: Mapping[str, str],
    plots: Mapping[str, Sequence[Any]],
) -> str:
    """Render a page beside whose file the plots lie as NAME.png.

    Parameters
    ----------
    entries : all tables and figures with their verdicts.
    rows : measured rows, those of an item one after the other.
    titles : what each item measures.
    plots : figures of each item.
    """
    values = {
        "entries": entries,
        "items": {name: list(own) for name, own in groupby(rows, lambda row: row["item"])},
        "titles": titles,
        "plots": plots,
        "small": any(row["pixels"] for row in rows),
    }
    filters: dict[str, Callable[..., object]] = {
        "value": significant,
        "grade": _grade,
        "interval": _interval,
    }
    return render_page(_PAGE, values, filters)


def _interval(half: float | None) -> str:
    return "" if half is None else f" ± {half:.2g}"


def _grade(verdict: str) -> str:
    """Choose the style of a verdict."""
    return {
        "reproduced": "good",
        "exceeds": "good",
        "below": "bad",
        "not reproduced": "bad",
        "not reached": "bad",
    }.get(verdict, "")
