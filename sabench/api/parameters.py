"""Base classes of plug-ins and of their parameters."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field


class Parameters(BaseModel):
    """Base of a plug-in's parameters: immutable, unknown names refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class FileParameters(Parameters):
    """Base of the parameters of a generator that reads a file.

    A data set keeps a copy of the file.
    """

    file: str = Field(description="its path, from the scene file's folder")
    sha256: str | None = Field(
        None, pattern="^[0-9a-f]{64}$", description="of the file: filled in where it is not given"
    )


class PlugIn:
    """Attributes that all plug-ins have."""

    name: ClassVar[str]
    references: ClassVar[tuple[str, ...]] = ()
    Parameters: ClassVar[type[Parameters]] = Parameters

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters
