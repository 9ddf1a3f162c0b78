"""Validation of users' input by pydantic models, every fault named by its key.

At the end are the types of numbers, vectors and tables in scenes and in parameters of plug-ins.
"""

import contextlib
import difflib
import math
import re
import types
import typing
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PositiveFloat, ValidationError

from sabench.utils.errors import InputError

UNION_TAG = "union:"  # start of the tags of unions with members that a function distinguishes
_SHOWN = 80  # characters of a value that a sentence quotes
_WORDS = (  # pydantic's words and ours, tried one after the other
    (r"^input should be a valid (\w+), .*", r"expected a valid \1"),
    (r"^input should be (greater|less) than", r"expected a number \1 than"),
    (r"^input should be (?:a valid )?(?:tuple|list|array)$", "expected a list"),
    (r"^input should be a valid dictionary.*", "expected a table"),
    (r"^input should be ('.*' or '.*')", r"expected \1"),
    (r"^input should be", "expected"),
    (r"^(?:tuple|list) should have (at (?:least|most) \d+ items?).*", r"expected \1"),
    (r"^string should match pattern", "expected text that matches"),
    (r"^string should have", "expected text with"),
)


class FaultsError(ValueError):
    """All faults that a validator of a whole table finds in it.

    Attributes
    ----------
    faults : pairs of a key of the table, or "" for the table as a whole, and a sentence.
    """

    def __init__(self, faults: Sequence[tuple[str, str]]) -> None:
        super().__init__("; ".join(f"{key}: {text}" if key else text for key, text in faults))
        self.faults = tuple(faults)


def refuse(faults: Iterable[tuple[str, str]]) -> None:
    """Raise all faults, pairs of a key and a sentence, if there are some."""
    if pairs := list(faults):
        raise FaultsError(pairs)


def join_faults(error: ValidationError, faults: Sequence[tuple[str, str]]) -> ValidationError:
    """Join the faults of fields and those of the whole table in one error."""
    details: list[Any] = [
        {key: value for key, value in fault.items() if key in ("type", "loc", "input", "ctx")}
        for fault in error.errors(include_url=False)
    ]
    if faults:
        whole = {"error": FaultsError(faults)}
        details.append({"type": "value_error", "input": None, "ctx": whole})
    return ValidationError.from_exception_data(error.title, details)


def printable(text: str, longest: int = _SHOWN) -> str:
    """Cut foreign text to one line; unprintable characters become question marks."""
    clean = "".join(mark if mark.isprintable() else "?" for mark in text[: longest + 1])
    return clean if len(clean) <= longest else f"{clean[: longest - 3]}..."


def sentences(model: type[BaseModel], error: ValidationError, prefix: str = "") -> list[str]:
    """Name every fault of a validation: its key behind `prefix`, and what is wrong.

    A key that is missing because it was misspelt is one fault, not two.
    """
    faults, misspelt = [], set()
    for fault in error.errors(include_url=False):
        path = _key_path(model, fault["loc"])
        unknown = fault["type"] == "extra_forbidden"
        near = nearest_word(path[-1], _keys_at(model, path)) if unknown else None
        if near:
            misspelt.add((*path[:-1], near))
        faults += [(path + key, kind, text) for key, kind, text in _texts(model, fault, path, near)]
    return [
        f"{prefix}{'.'.join(path)}: {text}" if prefix or path else text
        for path, kind, text in faults
        if kind != "missing" or tuple(path) not in misspelt
    ]


def _texts(
    model: type[BaseModel], fault: Any, path: list[str], near: str | None
) -> Iterator[tuple[list[str], str, str]]:
    kind, inner = fault["type"], fault.get("ctx", {}).get("error")
    if isinstance(inner, FaultsError):
        for key, text in inner.faults:
            yield ([key] if key else []), kind, text
    elif kind == "extra_forbidden":
        keys = ", ".join(_keys_at(model, path))
        hint = f"did you mean {near}?" if near else f"expected one of {keys}"
        yield [], kind, f"unknown key; {hint}"
    elif kind == "missing":
        yield [], kind, "this key is missing"
    elif kind in ("union_tag_not_found", "union_tag_invalid"):
        key, tag = fault["ctx"]["discriminator"].strip("'"), fault["ctx"].get("tag")
        tags, got = fault["ctx"].get("expected_tags"), printable(repr(tag))
        expected = f"expected one of {tags}, got {got}"
        yield [key], kind, expected if tag else "this key is missing"
    elif kind == "value_error":
        yield [], kind, str(fault["msg"]).removeprefix("Value error, ")
    else:
        text = str(fault["msg"])
        text = f"{text[0].lower()}{text[1:]}"
        for pattern, words in _WORDS:
            text, changed = re.subn(pattern, words, text)
            if changed:
                break
        yield [], kind, f"{text}, got {printable(repr(fault['input']))}"


def nearest_word(word: str, words: Iterable[str], alike: float = 0.4) -> str | None:
    """Find the known word that a misspelt one most likely stands for.

    None if no word is so `alike`, from 0 (anything) to 1 (equal).
    """
    near = difflib.get_close_matches(word, list(words), 1, alike)
    return near[0] if near else None


def _key_path(model: type[BaseModel], loc: tuple[Any, ...]) -> list[str]:
    """Give the path of TOML keys, without the tags that pydantic adds for unions."""
    models, path, tagged = [model], list[str](), False
    for part in map(str, loc):
        if not tagged and not part.startswith(UNION_TAG):
            path.append(part)
        fields = [table.model_fields[part] for table in models if part in table.model_fields]
        tagged = any(isinstance(field.discriminator, str) for field in fields)
        models = [inner for field in fields for inner in _models_in(field.annotation)] or models
    return path


def _keys_at(model: type[BaseModel], path: list[str]) -> list[str]:
    """List the keys that are valid in place of the last of `path`."""
    models: list[type[BaseModel]] = [model]
    for part in path[:-1]:
        if not part.isdigit():
            fields = [table.model_fields[part] for table in models if part in table.model_fields]
            models = [inner for field in fields for inner in _models_in(field.annotation)]
    return sorted({name for table in models for name in table.model_fields} - {path[-1]})


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    generic = isinstance(annotation, types.GenericAlias)
    if isinstance(annotation, type) and not generic and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in typing.get_args(annotation) for model in _models_in(inner)]


Model = typing.TypeVar("Model", bound=BaseModel)


def validate(model: type[Model], values: dict[str, Any], source: str, prefix: str = "") -> Model:
    """Make a model of `values`.

    Raises InputError: all faults of the values, each with its key behind `prefix`; `source` is
    named first.
    """
    try:
        made = model.model_validate(values)
    except ValidationError as error:
        raise InputError.from_faults(source, sentences(model, error, prefix)) from error
    if faults := [f"{prefix}{fault}" for fault in _recast("", values, made)]:
        raise InputError.from_faults(source, faults)
    return made


def _recast(key: str, given: Any, made: Any) -> Iterator[str]:
    """Name values that pydantic took for another kind: "3" or true for a number."""
    made = dict(made) if isinstance(made, BaseModel) else made
    if isinstance(given, list | tuple) and isinstance(made, list | tuple):
        given, made = dict(enumerate(given)), dict(enumerate(made))
    if isinstance(given, dict) and isinstance(made, dict):
        for name in filter(made.__contains__, given):
            yield from _recast(f"{key}.{name}".removeprefix("."), given[name], made[name])
    elif (kinds := {type(given), type(made)}) & {str, bool} and kinds & {int, float}:
        expected = "true or false" if isinstance(made, bool) else "a number"
        yield f"{key}: expected {expected}, got {printable(repr(given))}"


class Collector:
    """FaultsError of one file, collected over several checks and raised together."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.faults: list[str] = []

    @contextlib.contextmanager
    def collect(self) -> Iterator[None]:
        """Collect the faults of a check that raises an InputError without a source.

        The next check can then run.
        """
        try:
            yield
        except InputError as error:
            self.faults += error.faults

    def finish(self) -> None:
        """Raise an InputError of all faults that were collected, if there are some."""
        if self.faults:
            raise InputError.from_faults(self.source, self.faults)


Vector = tuple[float, float, float]


def _not_zero(vector: Vector) -> Vector:
    if math.hypot(*vector) < 1e-9:
        raise ValueError("expected a vector of non-zero length")
    return vector


Direction = Annotated[Vector, AfterValidator(_not_zero)]
Positive = PositiveFloat
TiltAngle = Annotated[float, Field(gt=-90.0, lt=90.0)]
Index = Annotated[float, Field(ge=1.0, le=4.0)]
LensNumber = Literal["principal_point", "k1", "k2", "p1", "p2", "k3", "tilt"]
WallNumber = Literal["wall", "thickness", "layer_index", "fluid_index"]
Unknown = LensNumber | WallNumber | Literal["bend"]


class Table(BaseModel):
    """Base of the tables of a file: immutable, unknown keys refused, numbers finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
