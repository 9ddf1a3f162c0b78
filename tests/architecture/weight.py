"""Weight of a checkout: lines, modules, imports, and the functions that a reader follows.

The walk from a function is an approximation: it enters every function and class of `sabench`, but
of `utils`, that the body of a function before it names. A class counts, but not its methods.
"""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tests.architecture.plan import arrows, lines, syntax

Place = tuple[str, str]  # dotted name of a module, name in it
Tables = dict[str, dict[str, "ast.AST | Place"]]
Def = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
STARTS = {
    "simulate": ("sabench.simulation.in_memory", "simulate"),
    "score of particles": ("sabench.tasks.particles", "score_particle_frame"),
}


def figures(root: Path) -> dict[str, float]:
    """Measure everything that `test_weight` limits."""
    package = root / "sabench"
    whole, apps = weigh(package), weigh(package / "apps")
    importers = Counter(imported for _, imported in arrows(package, files=True))
    found: dict[str, float] = {
        f"sabench without apps: {kind}": whole[kind] - apps[kind]
        for kind in ("lines", "code lines", "modules")
    }
    found |= {f"{name}: lines": lines(root / name) for name in ("reproduction", "tests")}
    found["apps: lines"] = apps["lines"]
    for room in ("", "algorithms/particles", "images"):
        found[f"constants of {room or 'sabench'}"] = constants(package / room)
    rooms = lines(package / "algorithms/particles") + lines(package / "images")
    found["particles and images: lines"] = rooms
    found["modules with one importer"] = sum(number == 1 for number in importers.values())
    found["import lines, percent"] = round(100 * whole["import lines"] / whole["lines"], 2)
    names = tables(package)
    for title, start in STARTS.items():
        reached = walk(names, start)
        found[f"walk of {title}: files"] = len({module for module, _ in reached})
        found[f"walk of {title}: names"] = len(reached)
    return found


def weigh(folder: Path) -> Counter[str]:
    """Count lines, code lines (no docstring, comment or blank), import lines and modules."""
    count: Counter[str] = Counter()
    for file in folder.rglob("*.py"):
        text, idle = file.read_text(encoding="utf-8").splitlines(), set()
        for node in ast.walk(syntax(file)):
            if isinstance(node, ast.Import | ast.ImportFrom):
                count["import lines"] += (node.end_lineno or 0) - node.lineno + 1
            elif isinstance(node, ast.Module | Def) and ast.get_docstring(node) is not None:
                idle |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
        idle |= {i for i, one in enumerate(text, 1) if one.strip()[:1] in ("", "#")}
        count.update(lines=len(text), modules=1)
        count["code lines"] += len(text) - len(idle)
    return count


def constants(folder: Path) -> int:
    """Count the names at the top of modules whose values hold a number."""
    count = 0
    for file in folder.rglob("*.py"):
        for node in syntax(file).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                values = [
                    one.value for one in ast.walk(node.value) if isinstance(one, ast.Constant)
                ]
                if any(
                    isinstance(one, int | float) and not isinstance(one, bool) for one in values
                ):
                    count += sum(len(getattr(target, "elts", [target])) for target in targets)
    return count


def tables(package: Path) -> Tables:
    """Return what every name of every module is: a definition, or a name of another module."""
    found: Tables = {}
    for file in sorted(package.rglob("*.py*")):
        if file.suffix not in (".py", ".pyi"):
            continue
        parts = file.relative_to(package.parent).with_suffix("").parts
        module = ".".join(parts).removesuffix(".__init__")
        table = found.setdefault(module, {})
        for node in ast.walk(syntax(file)):
            if isinstance(node, ast.ImportFrom):
                above = ".".join(parts[: -node.level] if node.level else ())
                source = ".".join(filter(None, (above, node.module)))
                table |= {one.asname or one.name: (source, one.name) for one in node.names}
        table |= {node.name: node for node in syntax(file).body if isinstance(node, Def)}
    return found


def walk(names: Tables, start: Place) -> set[Place]:
    """Return the functions and classes that a reader follows from one function."""
    reached, left = set(), [start]
    while left:
        place = left.pop()
        node = names[place[0]][place[1]]
        if place not in reached and isinstance(node, Def):
            reached.add(place)
            for part in () if isinstance(node, ast.ClassDef) else node.body:
                left += [one for inner in ast.walk(part) for one in named(names, place[0], inner)]
    return reached


def named(names: Tables, module: str, node: ast.AST) -> Iterator[Place]:
    """Yield the definition that a name, or an attribute of an imported module, stands for."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        whole, name = names[module].get(node.value.id), node.attr
        place = (".".join(whole), name) if isinstance(whole, tuple) else ("", "")
    else:
        place = (module, node.id) if isinstance(node, ast.Name) else ("", "")
    while isinstance(target := names.get(place[0], {}).get(place[1]), tuple):
        place = target
    if target is not None and not place[0].startswith("sabench.utils"):
        yield place
