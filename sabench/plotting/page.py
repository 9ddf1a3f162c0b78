"""HTML pages of one file: templates with scripts, styles and data inside them."""

import base64
import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup


def render_page(
    template: str,
    values: Mapping[str, Any],
    filters: Mapping[str, Callable[..., object]] | None = None,
) -> str:
    """Fill a template's values in; strings are escaped, `Markup` is not."""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= filters or {}
    return environment.from_string(template).render(values)


def inline_code(
    folder: Path, scripts: Sequence[str], library: str, style: str = ""
) -> dict[str, Any]:
    """Return `style`, `script` and `library` for a template, and their `hashes`.

    Hashes are written as a content security policy names them. The scripts of a page are one
    function, with names separate from those of a library on the page.

    Parameters
    ----------
    folder : of page.css and the scripts NAME.js, which follow what all pages share.
    library : a script, escaped.
    style : rules before those of page.css.
    """
    files = [Path(__file__).with_name("page_elements.js")]
    files += [folder / f"{name}.js" for name in scripts]
    parts = "\n".join(file.read_text(encoding="utf-8") for file in files)
    texts = {
        "style": escape_code(style + (folder / "page.css").read_text(encoding="utf-8")),
        "script": escape_code(f"(() => {{\n{parts}}})();"),
        "library": library,
    }
    digests = {name: hashlib.sha256(text.encode()).digest() for name, text in texts.items()}
    hashes = {
        name: Markup(f"'sha256-{base64.b64encode(one).decode()}'") for name, one in digests.items()
    }
    return {name: Markup(text) for name, text in texts.items()} | {"hashes": hashes}


def inline_json(value: Any) -> Markup:
    """Write a value as JSON that cannot contain markup."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))


def escape_code(text: str) -> str:
    """Escape a text so that a script or style element can hold it."""
    return re.sub(
        r"<(?=/script|/style|!--)", r"<\\", text.replace("\r\n", "\n"), flags=re.IGNORECASE
    )
