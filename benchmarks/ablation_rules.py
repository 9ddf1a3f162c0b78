"""Rules of a room for `ablation.py`: statements of numbers, branches, and how they are changed.

`rules_of` finds the statements of numbers at the top of a room's modules. `STRUCTURE` lists those
that are no rules, `OFF` the values, and the bodies of functions, that switch a rule off.
"""

import ast
import functools
from dataclasses import dataclass
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]

# numbers that are no rules: indices, sizes of arrays, units, series and formats
STRUCTURE = {
    "algorithms.particles.image_model.SHAPES",
    "algorithms.particles.image_model._ANY_ORDER",
    "algorithms.calibration.kernels.CAMERA",
    "algorithms.calibration.kernels.BOARD",
    "algorithms.calibration.kernels.BEND",
    "algorithms.calibration.parameters.WALL",
    "images.widths.PIXEL",
    "images.statistics.DEPTHS",
    "images.statistics.SCALED_WHITE",
}

# a rule's value, or the body of a function, that switches it off
OFF = {
    "algorithms.particles.bayesian_ipr._DARKEST": "(0.45,)",
    "algorithms.particles.bayesian_ipr.split_and_find": "return 0",
    "algorithms.particles.particle_search._FLOOR": "0.0",
    "algorithms.particles.particle_search._SETTLED": "0.0",
    "algorithms.particles.particle_search._TRIAL_FITS": "0",
    "algorithms.particles.learned_model.align_cameras": "pass",
    "algorithms.particles.learned_model.learn_widths": "pass",
    "algorithms.particles.learned_model._keep_plain": "pass",
    "algorithms.particles.learned_model.learn_light": "pass",
    "algorithms.particles.obstacles.find_partly_hidden": "return []",
    "algorithms.particles.obstacles.find_dark_views": "return np.zeros(clear.images.shape, bool)",
    "algorithms.particles.obstacles.without_wrong_cameras": "return search",
    "algorithms.particles.candidate_search.wide_enough": "return images, sigma",
    "algorithms.particles.dense_start.are_mostly_wrong": "return False",
    "algorithms.calibration.disparity._by_parts": "return np.ones((1, 1)), whole[None]",
    "algorithms.calibration.factorisation._FOCAL": "0.0",
    "algorithms.calibration.joint_fit.ROUNDS": "1",
    "algorithms.calibration.problem._check_corners": "return",
    "algorithms.calibration.problem._check_distances": "return",
    "algorithms.calibration.problem._check_mirror": "return",
    "algorithms.calibration.problem._check_names": "return",
    "algorithms.calibration.problem._check_views": "return",
    "algorithms.calibration.unknown_selection._LEAST_GAIN": "0.0",
    "algorithms.bubbles.backlit_images._SOFT": "1e-6",
    "algorithms.bubbles.rim_fit._PRIOR": "np.zeros(7)",
    "algorithms.bubbles.rim_fit._ROBUST": "1e3",
    "algorithms.bubbles.search._AGREE": "1.0",
    "algorithms.bubbles.search._SPREAD": "1e-3",
    "algorithms.bubbles.search._INWARD": "1.0",
    "algorithms.bubbles.search._SIMPLER": "0.0",
    "algorithms.bubbles.rim_fit._MARGIN": "0.0",
    "algorithms.bubbles.search._LIKELY": "0.0",
    "algorithms.bubbles.search._SURE": "0.0",
    "algorithms.bubbles.search._WORTH": "-1e9",
    "algorithms.bubbles.search._unite": "return bubbles",
    "algorithms.bubbles.search._drop_duplicates": "return hypotheses",
    "images.background.mark_edges": "return np.zeros(background.shape, dtype=np.bool_)",
    "images.background.find_glints": "return np.zeros(image.shape, dtype=np.bool_)",
    "images.background.clear_images": "return images, flaws",
    "images.widths._without_brightest": "return valid",
    "images.dark_noise._show_particles": "return False",
    "images.dark_noise._leave_out_bright": "return noise",
    "images.dark_noise._skewness": "return 0.0",
    "images.widths._light_of_peaks": "return math.inf",
    "images.repair.find_points": "return np.zeros(grey.shape, dtype=np.bool_)",
    "images.repair.find_reflections": "return np.zeros(grey.shape, dtype=np.bool_)",
}


@dataclass(frozen=True)
class Rule:
    """A statement of numbers, or a function, at the top of a module.

    Attributes
    ----------
    module : name, without the package's.
    name : of the first constant, or of the function.
    text : its code.
    variants : what takes the place of its value, or of its body, by name.
    kernels : names of the kernels that hold it.
    users : functions, as `module.name`, that the rule changes.
    """

    module: str
    name: str
    text: str
    variants: dict[str, str]
    kernels: set[str]
    users: set[str]

    @property
    def key(self) -> str:
        """Name the rule as the record does."""
        return f"{self.module}.{self.name}"


class Package:
    """Uses of names by the functions of the package."""

    def __init__(self) -> None:
        self.trees = {}
        for path in sorted((ROOT / "sabench").rglob("*.py")):
            module = ".".join(path.relative_to(ROOT / "sabench").with_suffix("").parts)
            self.trees[module] = ast.parse(path.read_text(encoding="utf-8"))
        self.uses: dict[str, dict[str, set[str]]] = {}  # of a name: functions by module
        self.kernels: set[str] = set()  # module.name
        for module, tree in self.trees.items():
            for node in ast.walk(tree):
                if isinstance(node, ast.FunctionDef):
                    marks = " ".join(map(ast.unparse, node.decorator_list))
                    if "njit" in marks or "inner_kernel" in marks:
                        self.kernels.add(f"{module}.{node.name}")
                    for one in ast.walk(node):
                        name = getattr(one, "id", None) or getattr(one, "attr", None)
                        if name and name != node.name:
                            users = self.uses.setdefault(name, {}).setdefault(module, set())
                            users.add(node.name)

    def users(self, module: str, names: list[str]) -> set[str]:
        """Find functions that use names of a module, and of kernels, what calls them."""
        found, todo = set(), [(module, name) for name in names]
        while todo:
            home, name = todo.pop()
            for where, functions in self.uses.get(name, {}).items():
                if name.startswith("_") and where != home:
                    continue
                for function in functions:
                    key = f"{where}.{function}"
                    if key not in found:
                        found.add(key)
                        if key in self.kernels:
                            todo.append((where, function))
        # constants that are made of these
        for node in self.trees[module].body:
            if isinstance(node, ast.Assign) and _names(node) != names:
                used = {getattr(one, "id", "") for one in ast.walk(node.value)}
                found |= self.users(module, _names(node)) if used & set(names) else set()
        return found


@functools.cache
def _package() -> Package:
    return Package()


def rules_of(room: str) -> list[Rule]:
    """List the rules of a room, module by module."""
    found, package = [], _package()
    for path in sorted((ROOT / "sabench" / room).rglob("*.py")):
        module = ".".join(path.relative_to(ROOT / "sabench").with_suffix("").parts)
        source = path.read_text(encoding="utf-8")
        for node in package.trees[module].body:
            for name in _names(node)[:1]:
                key, variants = f"{module}.{name}", {}
                if key in OFF:
                    variants["off"] = OFF[key]
                if isinstance(node, ast.Assign) and key not in STRUCTURE and _numbers(node.value):
                    for variant, by in (("doubled", 2.0), ("halved", 0.5)):
                        value = ast.unparse(_Scaled(by).visit(_copy(node.value)))
                        if value != ast.unparse(node.value):
                            variants[variant] = value
                if variants:
                    text = ast.get_source_segment(source, node) or ""
                    text = text if isinstance(node, ast.Assign) else text.partition("\n")[0]
                    if isinstance(node, ast.FunctionDef):
                        users = {key}
                    else:
                        users = package.users(module, _names(node))
                    kernels = {each.rpartition(".")[2] for each in users & package.kernels}
                    each = module, name, text, variants, kernels, users
                    found.append(Rule(*each))
    return found


def _names(node: ast.stmt) -> list[str]:
    if isinstance(node, ast.FunctionDef):
        return [node.name]
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name | ast.Tuple):
        return [each.id for each in ast.walk(node.targets[0]) if isinstance(each, ast.Name)]
    return []


def _copy(node: ast.expr) -> ast.expr:
    return ast.parse(ast.unparse(node), mode="eval").body


def _numbers(node: ast.expr) -> bool:
    return any(isinstance(each, ast.Constant) and _is_number(each.value) for each in ast.walk(node))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


class _Scaled(ast.NodeTransformer):
    """Multiply all numbers of an expression; of shares above one half, what is missing to one."""

    def __init__(self, by: float) -> None:
        self.by = by

    def visit_Call(self, node: ast.Call) -> ast.AST:
        """Scale a range, or an array, by its numbers; not the type of an array."""
        node.args = [self.visit(arg) for arg in node.args]
        return node

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        """Scale one number: whole ones stay whole, and 1 or more."""
        value: Any = node.value
        if not _is_number(value):
            return node
        if isinstance(value, int):
            scaled: Any = max(int(value * self.by), min(value, 1))
        elif 0.5 < value < 1.0:
            scaled = 1.0 - (1.0 - value) * self.by
        else:
            scaled = value * self.by
        return ast.Constant(scaled)


def change(rule_module: str, name: str, text: str) -> None:
    """Make this Python import a module with another value of a constant, or body of a function."""
    plain = SourceFileLoader.get_code

    def get_code(loader: SourceFileLoader, module: str) -> CodeType | None:
        if module != f"sabench.{rule_module}":
            return plain(loader, module)
        path = loader.get_filename(module)
        tree = ast.parse(Path(path).read_text(encoding="utf-8"))
        for node in tree.body:
            if name in _names(node)[:1]:
                if isinstance(node, ast.FunctionDef):
                    node.body, node.decorator_list = ast.parse(text).body, []
                elif isinstance(node, ast.Assign):
                    node.value = ast.parse(text, mode="eval").body
        return compile(ast.fix_missing_locations(tree), path, "exec")

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign, assignment]
