"""Scripts, styles and data within an HTML page."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from pathlib import Path


def escape_code(text: str) -> str:
    """Escape a text so that a script or style element can hold it."""
    return re.sub(
        r"<(?=/script|/style|!--)", r"<\\", text.replace("\r\n", "\n"), flags=re.IGNORECASE
    )


def hash_code(text: str) -> str:
    """Hash a script or style as a content security policy names it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def escape_json(text: str) -> str:
    """Escape JSON so that no markup can begin in it."""
    return text.replace("<", "\\u003c")


def join_scripts(folder: Path, names: Sequence[str]) -> str:
    """Join the scripts of a page in their order, after what all pages share.

    They are one function, whose names are separate from those of a library on the page.
    """
    files = [Path(__file__).with_name("page_elements.js")]
    files += [folder / f"{name}.js" for name in names]
    parts = "\n".join(file.read_text(encoding="utf-8") for file in files)
    return escape_code(f"(() => {{\n{parts}}})();")
