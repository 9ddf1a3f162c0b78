"""Read scene files and fill in the parameters of their generators."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from sabench import plugins
from sabench.scenes.build import build_rig
from sabench.scenes.bundled import find
from sabench.scenes.scene import WORLDS, Scene, plain
from sabench.utils.errors import InputError
from sabench.utils.files import sha256
from sabench.utils.validation import validate


def load_scene(path: str | Path) -> Scene:
    """Read and check a scene file; `path` may also be the name of a bundled scene.

    Raises
    ------
    InputError
        No such file, not TOML, an unknown key (with the nearest valid one), a wrong value or an
        impossible geometry.
    """
    file = find(path, "scenes")
    try:
        values = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{file}: expected a TOML file, got {error}") from error
    scene = parse_scene(values, str(file), file.parent)
    build_rig(scene, str(file))
    return scene


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
