"""Reference of all keys of a scene, in Markdown, from the schema of scenes."""

import functools
import json
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from markdown_table import escaped, written
from pydantic import BaseModel

from sabench.scenes import load_scene, scene_schema

_SCENES = sorted((Path(__file__).parents[2] / "scenes").glob("*.toml"))
_UNITS = {
    "mm": "mm",
    "mm_s": "mm/s",
    "mm2_s": "mm^2/s",
    "mm3": "1/mm^3",
    "m_s2": "m/s^2",
    "kg_m3": "kg/m^3",
    "s": "s",
    "1_s": "1/s",
    "hz": "Hz",
    "nm": "nm",
    "mj": "mJ",
    "deg": "degrees",
    "deg_s": "degrees/s",
    "px": "px",
    "c": "degrees Celsius",
    "percent": "%",
    "e": "electrons",
    "e_s": "electrons/s",
    "dn": "grey values",
    "dn_e": "grey values/electron",
}
_PICTURES = "../../scenes/pictures"  # from the page
_LONG = 40  # characters of a value, beyond which a table shows only its start


class Key(NamedTuple):
    """One key of a table, as the page shows it."""

    name: str
    meaning: str
    unit: str
    allowed: str
    default: str
    typical: str


class Table(NamedTuple):
    """One table of the schema: its path in a scene, the name of its model, its schema."""

    path: str
    name: str
    schema: dict[str, Any]

    @property
    def heading(self) -> str:
        """Heading of the section of the table."""
        keys = self.schema["properties"].items()
        kind = next((f", {key} `{part['const']}`" for key, part in keys if "const" in part), "")
        return f"`{self.path}`{kind}" if self.path else "Top level"


class Section(NamedTuple):
    """One table of a scene: its heading, its sentence, its keys."""

    heading: str
    text: str
    keys: list[Key]


def unit_of(name: str) -> str:
    """Return the unit that the suffix of a key names; "-" without one."""
    words = name.split("_")
    tails = ["_".join(words[start:]) for start in range(1, len(words))]
    return next((_UNITS[tail] for tail in tails if tail in _UNITS), "-")


def used_values() -> dict[str, Counter[str]]:
    """Count the values that bundled scenes give to each key, by `TABLE.KEY`."""
    found: dict[str, Counter[str]] = defaultdict(Counter)
    for path in _SCENES:
        _count(load_scene(path), found)
    return found


def _count(value: Any, found: dict[str, Counter[str]]) -> None:
    """Count the given keys of a model and of all that it holds."""
    if isinstance(value, BaseModel):
        name, given = (
            type(value).__name__,
            {key: getattr(value, key) for key in value.__pydantic_fields_set__},
        )
    elif isinstance(value, dict) and "generator" in value:
        name, given = str(value["generator"]), value
    else:
        for one in value if isinstance(value, tuple) else ():
            _count(one, found)
        return
    for key, inner in given.items():
        if inner is not None:
            found[f"{name}.{key}"][shown(inner)] += 1
        _count(inner, found)


def shown(value: Any) -> str:
    """Write a value as TOML does, cut where it is long."""
    if isinstance(value, BaseModel):
        return "table"
    text = json.dumps(value, default=lambda one: one.model_dump(exclude_none=True))
    return f"`{text}`" if len(text) <= _LONG else f"`{text[: _LONG - 3]}...`"


@functools.cache
def sections() -> list[Section]:
    """Describe all tables of a scene, each once, in the order of their first use."""
    schema, used = scene_schema(), used_values()
    waiting, found = [Table("", "Scene", schema)], {}
    while waiting:
        table = waiting.pop(0)
        if table.name not in found:
            found[table.name] = table
            waiting[:0] = _tables_in(table, schema["$defs"]).values()
    return [_section(table, found, used, schema["$defs"]) for table in found.values()]


def _tables_in(table: Table, known: dict[str, Any]) -> dict[str, Table]:
    """Return the tables that the keys of a table hold, by name."""
    inner: dict[str, Table] = {}
    for key, part in table.schema["properties"].items():
        for one in _tables(f"{table.path}.{key}" if table.path else key, part, known):
            inner.setdefault(one.name, one)
    return inner


def _tables(path: str, part: dict[str, Any], known: dict[str, Any]) -> Iterator[Table]:
    """Yield the tables that a key may hold."""
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        yield Table(path, name.rpartition(".")[2], known[name])
    elif "generator" in part.get("properties", {}):
        yield Table(path, part["properties"]["generator"]["const"], part)
    inner = [option for word in ("oneOf", "anyOf") for option in part.get(word, ())]
    inner += [part[word] for word in ("items", "additionalProperties") if word in part]
    for one in inner:
        if isinstance(one, dict):
            yield from _tables(path, one, known)


def _section(
    table: Table, tables: dict[str, Table], used: dict[str, Counter[str]], known: dict[str, Any]
) -> Section:
    """Describe one table."""
    properties, text = table.schema["properties"], table.schema.get("description", "")
    if "generator" in properties:
        text = f"{properties['generator']['description']} {text}"
    required, keys = table.schema.get("required", []), []
    for key, part in properties.items():
        first = next(_tables(key, part, known), None)
        counts = used.get(f"{table.name}.{key}", Counter())
        typical = _link(tables[first.name]) if first else _typical(part, counts)
        default = part.get("default")
        given = "none" if default is None else "its defaults" if first else shown(default)
        keys.append(
            Key(
                key,
                part.get("description", ""),
                unit_of(key),
                allowed(part),
                "required" if key in required else given,
                typical,
            )
        )
    return Section(table.heading, " ".join(text.split()), keys)


def _link(table: Table) -> str:
    """Link to the section of a table."""
    return f"[{table.heading}](#{_anchor(table.heading)})"


def _typical(part: dict[str, Any], counts: Counter[str]) -> str:
    """Return the only value, an example, the most frequent value or the default of a key."""
    if "const" in part:
        return shown(part["const"])
    if "examples" in part:
        return shown(part["examples"][0])
    if counts:
        return min(counts, key=lambda one: (-counts[one], one))
    return "" if part.get("default") is None else shown(part["default"])


def allowed(part: dict[str, Any]) -> str:
    """Describe the values that a key may have."""
    options = [
        one
        for word in ("oneOf", "anyOf")
        for one in part.get(word, ())
        if one.get("type") != "null"
    ]
    if options:
        return " or ".join(dict.fromkeys(allowed(one) for one in options))
    if "$ref" in part or "properties" in part or part.get("type") == "object":
        return "table"
    if "enum" in part or "const" in part:
        return " or ".join(f"`{one}`" for one in part.get("enum", [part.get("const")]))
    if part.get("type") == "array":
        return _array(part)
    return _scalar(part)


def _array(part: dict[str, Any]) -> str:
    """Describe a list: its length and its elements."""
    items = part.get("prefixItems") or [part.get("items", {})]
    inner = " or ".join(dict.fromkeys(allowed(one) for one in items))
    many = re.sub("^(number|integer|table|list|text)", r"\1s", inner).replace("texts", "words")
    count = part.get("maxItems") if part.get("maxItems") == part.get("minItems") else None
    return f"{count} {many}" if count else f"list of {many}"


def _scalar(part: dict[str, Any]) -> str:
    """Describe a number, a word or a truth value, with its limits."""
    words = {
        "number": "number",
        "integer": "integer",
        "boolean": "`true` or `false`",
        "string": "text",
    }
    signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    limits = [f"{sign} {part[key]:g}" for key, sign in signs.items() if key in part]
    if "minimum" in part and "maximum" in part:
        limits = [f"from {part['minimum']:g} to {part['maximum']:g}"]
    return " ".join([words.get(part.get("type", ""), "any value"), ", ".join(limits)]).strip()


def faults(found: list[Section]) -> list[str]:
    """Name the keys that lack a description or a typical value."""
    return [
        f"{section.heading}: {key.name}: expected a {what}"
        for section in found
        for key in section.keys
        for what, text in (("description", key.meaning), ("typical value", key.typical))
        if not text
    ]


def reference() -> str:
    """Write the list of tables of a scene, then a section with the keys of each."""
    found = sections()
    contents = [
        f"| [{section.heading}](#{_anchor(section.heading)}) | {escaped(first.rstrip('.'))} |"
        for section in found
        for first in [section.text.partition(". ")[0]]
    ]
    head = "| table | contents |\n|---|---|\n"
    return "\n\n".join([head + "\n".join(contents), *map(_written, found)])


def pictures() -> str:
    """Write the bundled scenes, each with its title, an image of a camera, and the rig."""
    rows = [
        [f"`{path.stem}`: {load_scene(path).title} ![Image and rig]({_PICTURES}/{path.stem}.webp)"]
        for path in _SCENES
    ]
    return written(["name, title, image and rig"], rows)


def _written(section: Section) -> str:
    """Write one table's section."""
    rows = [f"| `{key.name}` | {' | '.join(map(escaped, key[1:]))} |" for key in section.keys]
    head = "| key | meaning | unit | allowed | default | typical |\n|---|---|---|---|---|---|"
    return "\n".join([f"## {section.heading}\n", f"{section.text}\n", head, *rows])


def _anchor(heading: str) -> str:
    kept = "".join(letter for letter in heading.lower() if letter.isalnum() or letter in "_- ")
    return kept.replace(" ", "-")
