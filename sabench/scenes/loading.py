"""Scenes and other tables from what users write, and sentences for whatever is wrong with it."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any

from sabench import plugins
from sabench.scenes.schema import WORLDS, Scene, plain
from sabench.utils.errors import InputError
from sabench.utils.files import sha256
from sabench.utils.validation import validate


def find(name: str | Path, folder: str) -> Path:
    """`name` as a path, or as the stem of a TOML file in a bundled folder (scenes, scenes/suites)."""
    direct = Path(name)
    if any(len(part.encode("utf-8", "replace")) > 255 for part in direct.parts) or "\0" in str(
        name
    ):
        raise InputError(f"{name}: expected a file's name")
    if direct.is_file():
        return direct
    inside = plugins.bundled("scenes").parent / folder
    stem = direct.name.removesuffix(".toml")
    bundled = inside / f"{stem}.toml"
    if direct.parent in (Path(), Path(folder), Path("suites")) and bundled.is_file():
        return bundled
    known = sorted(file.stem for file in inside.glob("*.toml"))
    near = difflib.get_close_matches(stem, known, 1)
    raise InputError(
        f"{name}: expected a file or one of {', '.join(known)}"
        + (f"; did you mean {near[0]}?" if near else "")
    )


def parse_scene(values: dict[str, Any], source: str, folder: Path | None = None) -> Scene:
    """A scene from its keys and values; `source` is named in errors, `folder` is where its files are looked for."""
    scene = validate(Scene, values, source)
    here, tables = folder or Path(), {table: getattr(scene, table) for table in WORLDS}
    made: dict[str, Any] = {
        table: _resolved(table, table, given, source, here)
        for table, given in tables.items()
        if given is not None
    }
    if scene.solids is not None:
        made["solids"] = tuple(
            _resolved("solids", f"solids.{number}", given, source, here)
            for number, given in enumerate(scene.solids)
        )
    return scene.model_copy(update=made)


def _resolved(
    makes: str, table: str, given: dict[str, Any], source: str, folder: Path
) -> dict[str, Any]:
    """A generator's table with all its parameters."""
    rest = dict(given)
    name = rest.pop("generator", None)
    if not isinstance(name, str):
        raise InputError(
            f"{source}: {table}.generator: expected the name of a generator, got {name!r}"
        )
    try:
        plugin = plugins.load("generators", name)
    except InputError as error:
        raise InputError(f"{source}: {table}.generator: {error}") from error
    if plugin.makes != makes:
        raise InputError(
            f"{source}: {table}.generator: expected a generator of {makes}, got {name}, which makes {plugin.makes}"
        )
    parameters = validate(plugin.Parameters, rest, source, f"{table}.")
    made = {"generator": name, **plain(parameters.model_dump(mode="json", exclude_none=True))}
    if "file" not in plugin.Parameters.model_fields:
        return made
    found = _found(made, f"{source}: {table}", folder)
    return {**{key: value for key, value in made.items() if key not in found}, **found}


def _found(made: dict[str, Any], where: str, folder: Path) -> dict[str, str]:
    """A file's whole path, and what its content is."""
    path = (folder / made["file"]).resolve()
    if not path.is_file():
        raise InputError(f"{where}.file: expected a file, but there is none at {path}")
    content = sha256(path)
    if made.get("sha256", content) != content:
        raise InputError(
            f"{where}.sha256: expected {made['sha256'][:12]}... of {path}, got {content[:12]}...: the file has changed"
        )
    return {"file": str(path), "sha256": content}


def schema() -> dict[str, Any]:
    """The JSON schema of a scene, with the parameters of every installed generator under the table that it fills."""
    whole = Scene.model_json_schema()
    choices: dict[str, list[Any]] = {table: [{"type": "null"}] for table in WORLDS} | {"solids": []}
    for name in plugins.names("generators"):
        plugin = plugins.load("generators", name)
        table = plugin.Parameters.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
        whole["$defs"].update(
            {f"{name}.{key}": value for key, value in table.pop("$defs", {}).items()}
        )
        table["properties"] = {"generator": {"const": name}, **table.get("properties", {})}
        table["required"] = ["generator", *table.get("required", [])]
        choices[plugin.makes].append(table)
    solids = {
        "oneOf": [{"type": "null"}, {"type": "array", "items": {"oneOf": choices.pop("solids")}}]
    }
    whole["properties"] |= {table: {"oneOf": options} for table, options in choices.items()} | {
        "solids": solids
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **whole}
