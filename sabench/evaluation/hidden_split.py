"""Private test sets: data sets that only their organiser can make.

Their seeds come from a file with a secret, which only the organiser has.
"""

from __future__ import annotations

import hashlib
import hmac
import tomllib
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from sabench.utils.errors import InputError
from sabench.utils.validation import validate


class Secret(BaseModel):
    """Content of the file: a secret, and the number of seeds of each case."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    secret: str = Field(min_length=16, description="random text, as from `openssl rand -hex 16`")
    seeds: int = Field(5, ge=1, description="data sets of each case")

    def seeds_of(self, suite: str, version: int, case: str) -> tuple[int, ...]:
        """Derive the seeds of a case from the secret.

        A seed is HMAC-SHA256 (RFC 2104) of suite, version, case and number, so that seeds disclose
        neither the secret nor each other.
        """
        purposes = (f"{suite}\0{version}\0{case}\0{number}" for number in range(self.seeds))
        drawn = (
            hmac.new(self.secret.encode(), purpose.encode(), hashlib.sha256).digest()
            for purpose in purposes
        )
        return tuple(int.from_bytes(one[:8], "big") >> 1 for one in drawn)


def read_secret(path: Path) -> Secret:
    """Read the secret of a TOML file.

    Raises
    ------
    InputError
        No such file, no TOML, or a secret of fewer than 16 characters, which the error does not
        repeat.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected a TOML file, got {type(error).__name__}") from error
    if isinstance(values.get("secret"), str) and len(values["secret"]) < 16:
        raise InputError(
            f"{path}: secret: expected 16 characters or more, got {len(values['secret'])}"
        )
    return validate(Secret, values, str(path))
