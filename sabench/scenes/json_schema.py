"""The JSON schema of scene files, for editors."""

from __future__ import annotations

from typing import Any

from sabench import plugins
from sabench.scenes.scene import WORLDS, Scene


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
    types: dict[str, Any] = {table: {"oneOf": choices[table]} for table in WORLDS}
    types["solids"] = {
        "oneOf": [{"type": "null"}, {"type": "array", "items": {"oneOf": choices["solids"]}}]
    }
    for table, one in types.items():
        shared = whole["properties"][table]
        whole["properties"][table] = {"description": shared["description"], "default": None, **one}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **whole}
