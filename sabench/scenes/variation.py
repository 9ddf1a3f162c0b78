"""Table of a scene for values that differ from sample to sample, and their draws."""

from __future__ import annotations

import copy
import math
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from sabench.utils.rng import stream
from sabench.utils.validation import Positive, Table, refuse

# what all samples of a stream share: the shape of their images, and the draws themselves
_SHARED = ("title", "vary", "frames", "cameras.rows", "cameras.columns")


class Draw(Table):
    """Values that a key of the scene may have: exactly one of three distributions."""

    uniform: tuple[float, float] | None = Field(
        None,
        description="smallest and largest value of a uniform distribution",
        examples=[[10.0, 40.0]],
    )
    log_uniform: tuple[Positive, Positive] | None = Field(
        None,
        description="smallest and largest value; the logarithm is uniform",
        examples=[[0.01, 0.1]],
    )
    choices: tuple[Any, ...] | None = Field(
        None,
        min_length=1,
        description="values of equal probability, of any type",
        examples=[["mie", "isotropic"]],
    )

    @model_validator(mode="after")
    def _check(self) -> Draw:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        faults = []
        if len(given) != 1:
            got = " and ".join(given) or "none"
            faults.append(("", f"expected one of uniform, log_uniform and choices, got {got}"))
        for name in ("uniform", "log_uniform"):
            if (ends := getattr(self, name)) and not ends[0] < ends[1]:
                faults.append(
                    (name, f"expected the least value before the largest, got {list(ends)}")
                )
        refuse(faults)
        return self

    def value(self, share: float) -> Any:
        """Return the value at a share in [0, 1) of the distribution."""
        if self.choices is not None:
            return self.choices[int(share * len(self.choices))]
        if self.log_uniform is not None:
            low, high = (math.log(bound) for bound in self.log_uniform)
            return math.exp(low + share * (high - low))
        low, high = self.uniform or (0.0, 0.0)
        return low + share * (high - low)


class Vary(Table):
    """Keys of a scene with values that every sample draws anew."""

    draw: dict[str, Draw] = Field(
        min_length=1,
        description='distributions by key, with dots between tables: "particles.per_pixel"',
    )
    impossible: Literal["refuse", "redraw"] = Field(
        "refuse", description="handling of a sample whose scene or rig is impossible"
    )


def check_keys(vary: Vary, values: dict[str, Any]) -> list[tuple[str, str]]:
    """List faults of keys that vary, by the scene's values: places, and sentences."""
    faults = []
    for key in vary.draw:
        where = f"vary.draw.{key}"
        if key in _SHARED:
            faults.append((where, "expected a key that samples need not share, got this one"))
        elif _table_of(values, key) is None:
            table = key.rpartition(".")[0]
            faults.append((where, f"expected a key of the scene, which has no table {table!r}"))
    return faults


def draw_values(vary: Vary, seed: int, sample: int, attempt: int) -> dict[str, Any]:
    """Draw a sample's values by key; equal arguments give equal ones."""
    rng = stream(seed, "vary", sample, attempt)
    shares = rng.random(len(vary.draw)).tolist()
    return {
        key: vary.draw[key].value(draw) for key, draw in zip(sorted(vary.draw), shares, strict=True)
    }


def extremes(vary: Vary) -> list[dict[str, Any]]:
    """List draws at the ends of all ranges: each key's own, and all keys' together."""
    last = float(np.nextafter(1.0, 0.0))
    ends = {key: (draw.value(0.0), draw.value(last)) for key, draw in vary.draw.items()}
    alone = [{key: value} for key, pair in ends.items() for value in pair]
    return [*alone, *({key: pair[end] for key, pair in ends.items()} for end in (0, 1))]


def with_values(values: dict[str, Any], drawn: dict[str, Any]) -> dict[str, Any]:
    """Return a scene's values with some that were drawn, and nothing that varies."""
    changed: dict[str, Any] = copy.deepcopy({k: v for k, v in values.items() if k != "vary"})
    for key, value in drawn.items():
        table, leaf = _table_of(changed, key), key.rpartition(".")[2]
        table[int(leaf) if isinstance(table, list) else leaf] = value
    return changed


def _table_of(values: dict[str, Any], key: str) -> Any:
    """Find the table or list that holds a dotted key; None where there is none."""
    here: Any = values
    *path, leaf = key.split(".")
    for part in path:
        if isinstance(here, list) and part.isdigit() and int(part) < len(here):
            here = here[int(part)]
        elif isinstance(here, dict):
            here = here.get(part)
        else:
            return None
    if isinstance(here, list):
        return here if leaf.isdigit() and int(leaf) < len(here) else None
    return here if isinstance(here, dict) else None
