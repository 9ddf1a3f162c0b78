"""Cameras of any model as JSON keeps them."""

import functools
import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Any, Union, cast

import numpy as np
from pydantic import (
    BeforeValidator,
    Discriminator,
    GetPydanticSchema,
    Tag,
    TypeAdapter,
    ValidationError,
)

from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.central_camera import CentralCamera
from sabench.geometry.lens import UPRIGHT
from sabench.geometry.polynomial_cameras import PlanePolynomials, Soloff
from sabench.geometry.projective_camera import Projective
from sabench.utils.arrays import LARGEST, U8
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json
from sabench.utils.validation import UNION_TAG, printable

MODELS: dict[str, type[Any]] = {
    "pinhole": Camera,
    "projective": Projective,
    "soloff": Soloff,
    "polynomial_planes": PlanePolynomials,
    "central": CentralCamera,
}


def _model_of(value: Any) -> str:
    if isinstance(value, dict):
        return f"{UNION_TAG}{value.get('model', 'pinhole')}"
    named = (name for name, model in MODELS.items() if type(value) is model)
    return f"{UNION_TAG}{next(named, '')}"


def _without_model(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {key: field for key, field in value.items() if key != "model"}


def _any_model() -> Any:
    """Make the union of all models, distinguished by the key `model`."""
    members = [
        Annotated[model, BeforeValidator(_without_model), Tag(f"{UNION_TAG}{name}")]
        for name, model in MODELS.items()
    ]
    models = ", ".join(MODELS)
    return Annotated[
        Union[tuple(members)],  # noqa: UP007  # its members are known at run time only
        Discriminator(
            _model_of,
            custom_error_type="camera_model",
            custom_error_message=f"Input should be a camera with a model of {models}",
        ),
    ]


# Camera of any model as a field of a pydantic model; a record without `model` is a pinhole's.
CameraEntry = Annotated[CameraModel, GetPydanticSchema(lambda _, handler: handler(_any_model()))]


def record_camera(camera: CameraModel) -> dict[str, Any]:
    """Turn a camera into its JSON record: `model`, then the fields of that model.

    A sensor that is not tilted has no `tilt_deg`.
    """
    name = next(name for name, model in MODELS.items() if type(camera) is model)
    fields = asdict(cast(Any, camera))
    if fields.get("tilt_deg") == UPRIGHT:
        del fields["tilt_deg"]
    return {"model": name, **fields}


def read_camera(record: Any, where: str) -> CameraModel:
    """Make a camera from its JSON record.

    Raises InputError: an unknown model, or fields that are not the model's; `where` opens the
    sentence.
    """
    model = record.get("model") if isinstance(record, dict) else record
    if not isinstance(model, str) or model not in MODELS:
        models = ", ".join(sorted(MODELS))
        raise InputError(f"{where}: model: expected one of {models}, got {model!r}")
    fields = _without_model(record)
    check_largest(fields, where)
    try:
        return cast(CameraModel, _validator(model).validate_python(fields))
    except ValidationError as error:
        first = error.errors()[0]
        parts = (str(p).removeprefix(UNION_TAG) if isinstance(p, str) else p for p in first["loc"])
        raise InputError(f"{where}: {tuple(parts)}: {first['msg']}") from error


@functools.cache
def _validator(model: str) -> TypeAdapter[Any]:
    return TypeAdapter(MODELS[model])  # takes 8 ms


def check_largest(value: Any, where: str) -> None:
    """Refuse a number in tables and lists that is not finite or too large."""
    if bad := _extreme(value):
        raise InputError(
            f"{where}: {bad[0]}: expected finite numbers of at most {LARGEST:g}, got "
            f"{printable(str(bad[1]))}"
        )


def _extreme(value: Any, key: str = "") -> tuple[str, float] | None:
    """Find a number that is not finite or too large, with the name of its field."""
    if isinstance(value, int | float):
        return None if abs(value) <= LARGEST else (key, value)
    if isinstance(value, dict):
        items = [(f"{key}.{name}" if key else str(name), inner) for name, inner in value.items()]
    else:
        items = [(key, inner) for inner in value] if isinstance(value, list | tuple) else []
    return next((bad for name, inner in items if (bad := _extreme(inner, name))), None)


def encode_cameras(cameras: Sequence[CameraModel]) -> U8:
    """Encode cameras as the bytes (n,) of a JSON list."""
    text = canonical_json([record_camera(camera) for camera in cameras])
    return np.frombuffer(text.encode(), dtype=np.uint8)


def decode_cameras(code: U8) -> tuple[CameraModel, ...]:
    """Decode cameras from the bytes (n,) of a JSON list; raises as `read_camera`."""
    try:
        records = json.loads(code.tobytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"cameras: expected JSON, got {error}") from error
    if not isinstance(records, list):
        raise InputError(f"cameras: expected a list, got {type(records).__name__}")
    return tuple(read_camera(record, f"cameras: {number}") for number, record in enumerate(records))
