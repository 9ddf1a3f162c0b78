"""Reader of class attributes and faulty imports in source files.

It does not import the file.
"""

import ast
import functools
import importlib.util
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sabench.utils.code_hash import PACKAGE
from sabench.utils.errors import InputError


@dataclass(frozen=True)
class Class:
    """Class statement of a source file.

    First line of its docstring, string constants and names of its bases.
    """

    summary: str
    constants: dict[str, str]
    bases: tuple[str, ...]


@dataclass(frozen=True)
class SourceFile:
    """A parsed file.

    Attributes
    ----------
    classes : by name, those at the top level.
    imported : name in this file to (line, module, name there); the last is empty for a module.
    """

    file: Path
    classes: dict[str, Class]
    imported: dict[str, tuple[int, str, str]]


def parse_file(file: Path) -> SourceFile:
    """Read the classes and imports at the top level of a file.

    Raises InputError: the file cannot be read or is no Python.
    """
    try:
        statements = ast.parse(file.read_bytes(), str(file)).body
    except SyntaxError as error:
        raise InputError(f"{file}: line {error.lineno}: {error.msg}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: {error}") from error
    classes: dict[str, Class] = {}
    imported: dict[str, tuple[int, str, str]] = {}
    for statement in statements:
        if isinstance(statement, ast.ClassDef):
            lines = (ast.get_docstring(statement) or "").strip().splitlines()
            constants = dict(_constants(statement.body))
            bases = tuple(base.id for base in statement.bases if isinstance(base, ast.Name))
            classes[statement.name] = Class(lines[0] if lines else "", constants, bases)
        elif isinstance(statement, ast.Import):
            for alias in statement.names:
                imported[alias.asname or alias.name] = (statement.lineno, alias.name, "")
        elif isinstance(statement, ast.ImportFrom) and statement.module and not statement.level:
            for alias in statement.names:
                origin = (statement.lineno, statement.module, alias.name)
                imported[alias.asname or alias.name] = origin
    return SourceFile(file, classes, imported)


def _constants(body: list[ast.stmt]) -> Iterator[tuple[str, str]]:
    for statement in body:
        targets = statement.targets if isinstance(statement, ast.Assign) else []
        targets = [statement.target] if isinstance(statement, ast.AnnAssign) else targets
        value = getattr(statement, "value", None)
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield from ((item.id, value.value) for item in targets if isinstance(item, ast.Name))


def find_class(source: SourceFile, name: str) -> Class | None:
    """Find the only class with this string as its attribute `name`, or None."""
    matches = [cls for cls in source.classes.values() if cls.constants.get("name") == name]
    return matches[0] if len(matches) == 1 else None


def constant(source: SourceFile, of: Class, attribute: str) -> str | None:
    """Read a class's or its bases' string attribute; None if the source is unclear."""
    if attribute in of.constants:
        return of.constants[attribute]
    for base in of.bases:
        definition = _definition(source, base)
        value = constant(*definition, attribute) if definition else None
        if value is not None:
            return value
    return None


def _definition(source: SourceFile, name: str) -> tuple[SourceFile, Class] | None:
    """Find the statement of a class in this file or, by imports, in other files.

    Only imports from sabench are followed.
    """
    if name in source.classes:
        return source, source.classes[name]
    _, module, original = source.imported.get(name, (0, "", ""))
    file = _file_of(module)
    return _definition(_parse_once(file), original) if file and original else None


@functools.cache
def _parse_once(file: Path) -> SourceFile:
    return parse_file(file)


@functools.cache
def _file_of(module: str) -> Path | None:
    """Find the file of a module of sabench, without importing its package."""
    top, *parts = module.split(".")
    path = PACKAGE.joinpath(*parts)
    if top != PACKAGE.name:
        return None
    files = (path / "__init__.pyi", path / "__init__.py", path.with_suffix(".py"))
    return next((file for file in files if file.is_file()), None)


def import_fault(source: SourceFile) -> str:
    """Find the first import of a file that must fail; empty if there is none.

    Modules of sabench and the names imported from them are looked up in their sources, of other
    packages only that they are installed. So this is quick, and does not find every fault.
    """
    for line, module, name in source.imported.values():
        top = module.split(".")[0]
        if module.startswith(f"{PACKAGE.name}.plugins."):
            continue
        if top != PACKAGE.name:
            if not _is_installed(top):
                return f"line {line}: no module named {top!r} is installed"
        elif (file := _file_of(module)) is None:
            return f"line {line}: there is no module {module}"
        elif not (
            name in ("", "*")
            or re.search(rf"\b{re.escape(name)}\b", _text(file))
            or _file_of(f"{module}.{name}")
        ):
            return f"line {line}: {module} has no {name}"
    return ""


@functools.cache
def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8")


@functools.cache
def _is_installed(top: str) -> bool:
    loaded = top in sys.stdlib_module_names or top in sys.modules
    return loaded or importlib.util.find_spec(top) is not None
