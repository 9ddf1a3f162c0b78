"""Scene files, found by name, and their JSON schema.

They are loaded with the parameters of their generators.
"""

from pathlib import Path
from typing import Any

from sabench import plugins
from sabench.scenes.build import build_rig
from sabench.scenes.scene import WORLDS, Scene, plain
from sabench.scenes.variation import check_keys
from sabench.utils.errors import InputError
from sabench.utils.files import LONGEST_PART, file_series, read_toml, series_hash
from sabench.utils.validation import Collector, nearest_word, validate


def find(name: str | Path, folder: str) -> Path:
    """Find a file by its path, or by its stem in a bundled folder.

    Bundled folders are scenes and scenes/suites; suites are also found in reproduction/suites.

    Raises InputError: no such file, with the nearest name.
    """
    kind = "suite" if folder == "scenes/suites" else "scene"
    if not isinstance(name, str | Path):
        raise InputError(f"expected a {kind}, its file or its name, got {type(name).__name__}")
    direct = Path(name)
    longest = max((len(part.encode("utf-8", "replace")) for part in direct.parts), default=0)
    if longest > LONGEST_PART or "\0" in str(name):
        raise InputError(f"{name}: expected a file's name")
    if direct.is_file():
        return direct
    folders = [plugins.bundled_folder("scenes").parent / folder]
    if folder == "scenes/suites":
        folders = plugins.suite_folders()
    stem = direct.name.removesuffix(".toml")
    files = {file.stem: file for inside in folders for file in inside.glob("*.toml")}
    if stem in files and direct.parent in (Path(), Path(folder), Path("suites")):
        return files[stem]
    near = nearest_word(stem, files, 0.6)
    hint = f"did you mean {near}?" if near else f"sabench list --kind {kind} has their names"
    raise InputError(f"{name}: expected a file or the name of a bundled {kind}; {hint}")


def load_scene(path: str | Path) -> Scene:
    """Read and check a scene file; `path` may also be the name of a bundled scene.

    Raises InputError: no such file, not TOML, an unknown key (with the nearest valid one), a wrong
    value or an impossible geometry.
    """
    file = find(path, "scenes")
    scene = read_scene(file)
    build_rig(scene, str(file))
    return scene


def read_scene(path: str | Path) -> Scene:
    """Read a scene file without a look at its geometry: ten times as quick."""
    file = find(path, "scenes")
    return parse_scene(read_kind(file, "scene"), str(file), file.parent)


# keys of one kind of file alone
_KEYS = {"scene": {"volume", "grid"}, "suite": {"scenes", "cases", "solvers", "recordings"}}


def read_kind(file: Path, kind: str) -> dict[str, Any]:
    """Parse a TOML file; raise an InputError if it is another kind of file."""
    values = read_toml(file)
    for other, keys in _KEYS.items():
        if (has := keys & values.keys()) and not _KEYS[kind] & values.keys():
            raise InputError(f"{file}: expected a {kind}, got a {other}: {', '.join(sorted(has))}")
    return values


def parse_scene(values: dict[str, Any], source: str, folder: Path | None = None) -> Scene:
    """Make a scene of keys and values, with all parameters of its generators.

    Parameters
    ----------
    source : named in errors.
    folder : where the generators' files are looked for.

    Raises InputError: all unknown keys, missing keys and wrong values, also those of the
    generators.
    """
    check, here = Collector(source), folder or Path()
    tables: dict[str, Any] = {}
    with check.collect():
        scene = validate(Scene, values, "")
    for table in WORLDS:
        if isinstance(given := values.get(table), dict):
            with check.collect():
                tables[table] = _resolve(table, table, given, here)
    if isinstance(solids := values.get("solids"), list | tuple):
        tables["solids"] = ()
        for number, given in enumerate(solids):
            with check.collect():
                resolved = _resolve("solids", f"solids.{number}", given, here)
                tables["solids"] = (*tables["solids"], resolved)
    check.finish()
    whole = scene.model_copy(update=tables)
    if whole.vary is not None:
        faults = check_keys(whole.vary, whole.to_dict())
        check.faults += [f"{key}: {text}" for key, text in faults]
        check.finish()
    return whole


def _resolve(makes: str, table: str, given: Any, folder: Path) -> dict[str, Any]:
    if not isinstance(given, dict):
        return {}  # the scene's own check names it
    rest = dict(given)
    name = rest.pop("generator", None)
    if not isinstance(name, str):
        raise InputError(f"{table}.generator: expected the name of a generator, got {name!r}")
    try:
        plugin = plugins.load("generators", name)
    except InputError as error:
        raise InputError(f"{table}.generator: {error}") from error
    if plugin.makes != makes:
        expected = f"expected a generator of {makes}"
        raise InputError(f"{table}.generator: {expected}, got {name}, which makes {plugin.makes}")
    parameters = validate(plugin.Parameters, rest, "", f"{table}.")
    settings = {"generator": name, **plain(parameters.model_dump(mode="json", exclude_none=True))}
    if "file" not in plugin.Parameters.model_fields:
        return settings
    path = (folder / settings["file"]).resolve()
    if not file_series(path):
        raise InputError(f"{table}.file: expected a file, but there is none at {path}")
    content = series_hash(path)
    if settings.get("sha256", content) != content:
        changed = f"{settings['sha256'][:12]}... of {path}, got {content[:12]}..."
        raise InputError(f"{table}.sha256: expected {changed}: the file has changed")
    rest = {key: value for key, value in settings.items() if key not in ("file", "sha256")}
    return {**rest, "file": str(path), "sha256": content}


def scene_schema() -> dict[str, Any]:
    """Make the JSON schema of a scene.

    It includes the parameters of every installed generator. A generator's parameters are an option
    of the table that it fills.
    """
    whole = Scene.model_json_schema()
    choices: dict[str, list[Any]] = {table: [{"type": "null"}] for table in WORLDS} | {"solids": []}
    for name in plugins.names("generators"):
        plugin = plugins.load("generators", name)
        table = plugin.Parameters.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
        whole["$defs"].update(
            {f"{name}.{key}": value for key, value in table.pop("$defs", {}).items()}
        )
        generator = {"const": name, "description": plugins.summary(plugin)}
        table["properties"] = {"generator": generator, **table.get("properties", {})}
        table["required"] = ["generator", *table.get("required", [])]
        choices[plugin.makes].append(table)
    solids = {"type": "array", "items": {"oneOf": choices["solids"]}}
    for table, options in (choices | {"solids": [{"type": "null"}, solids]}).items():
        text = whole["properties"][table]["description"]
        whole["properties"][table] = {"description": text, "default": None, "oneOf": options}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **whole}
