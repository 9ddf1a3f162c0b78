"""What pydantic finds wrong in a file's keys and values, as one sentence that names the key."""

from __future__ import annotations

import difflib
import types
import typing
from typing import Any

from pydantic import BaseModel, ValidationError

from sabench.utils.errors import InputError


def printable(text: str, longest: int = 80) -> str:
    """Foreign text on one line that any terminal shows: what cannot be printed as a question mark, and no more than `longest` characters."""
    clean = "".join(mark if mark.isprintable() else "?" for mark in text[: longest + 1])
    return clean if len(clean) <= longest else f"{clean[: longest - 3]}..."


def sentence(model: type[BaseModel], error: ValidationError, prefix: str = "") -> str:
    """The first fault of values that are not a `model`: the key behind `prefix`, what was expected and what came."""
    faults = error.errors(include_url=False)
    fault = next(
        (f for f in faults if f["type"] == "extra_forbidden"), faults[0]
    )  # a typo explains the missing key
    path = [str(part) for part in _key_path(fault["loc"])]
    key = prefix + ".".join(path)
    return f"{key + ': ' if key else ''}{_text(model, fault, path)}"


def _text(model: type[BaseModel], fault: Any, path: list[str]) -> str:
    kind = fault["type"]
    if kind == "extra_forbidden":
        known = _keys_at(model, path[:-1])
        near = difflib.get_close_matches(path[-1], known, 1, 0.4)
        return (
            f"unknown key; did you mean {near[0]}?"
            if near
            else f"unknown key; expected one of {', '.join(known)}"
        )
    if kind == "missing":
        return "this key is missing"
    text = str(fault["msg"]).removeprefix("Value error, ")
    if kind == "value_error":
        return text
    return f"{text[0].lower()}{text[1:]}, got {fault['input']!r}"


def _key_path(loc: tuple[Any, ...]) -> list[Any]:
    """The fault's place as TOML keys: without the tags that pydantic adds for the kinds of a union."""
    tags = {"grid", "ring", "line", "cross", "list"}
    return [
        part for i, part in enumerate(loc) if not (i and loc[i - 1] == "layout" and part in tags)
    ]


def _keys_at(model: type[BaseModel], path: list[str]) -> list[str]:
    """Names that are valid inside the table at `path`."""
    models: list[type[BaseModel]] = [model]
    for part in path:
        if part.isdigit():
            continue
        models = [
            inner
            for outer in models
            if part in outer.model_fields
            for inner in _models_in(outer.model_fields[part].annotation)
        ]
    return sorted({name for table in models for name in table.model_fields})


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if (
        isinstance(annotation, type)
        and issubclass(annotation, BaseModel)
        and not isinstance(annotation, types.GenericAlias)
    ):
        return [annotation]
    return [model for inner in typing.get_args(annotation) for model in _models_in(inner)]


Model = typing.TypeVar("Model", bound=BaseModel)


def validate(model: type[Model], values: dict[str, Any], source: str, prefix: str = "") -> Model:
    """`values` as a model, or an InputError of one sentence for its first fault."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{source}: {sentence(model, error, prefix)}") from error
