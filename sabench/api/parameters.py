"""Base classes of plug-ins and of their parameters."""

from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field


class Parameters(BaseModel):
    """Base of a plug-in's parameters: immutable, unknown names refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class FileParameters(Parameters):
    """Base of the parameters of a generator that reads a file.

    A data set keeps a copy of the file.
    """

    file: str = Field(
        description="path of the file, from the scene file's folder", examples=["measured.h5"]
    )
    sha256: str | None = Field(
        None,
        pattern="^[0-9a-f]{64}$",
        description="SHA-256 of the file: filled in where it is not given",
        examples=["0" * 64],
    )


class PlugIn:
    """Attributes that all plug-ins have."""

    name: ClassVar[str]
    references: ClassVar[tuple[str, ...]] = ()
    Parameters: ClassVar[type[Parameters]] = Parameters

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters
