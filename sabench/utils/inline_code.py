"""Scripts, styles and data within an HTML page."""

from __future__ import annotations

import base64
import hashlib
import re


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
