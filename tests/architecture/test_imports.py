"""Imports go down the floors, in no circle; plug-ins use public packages; light ones stay light."""

import ast
from pathlib import Path

import pytest

from tests.architecture.plan import FLOORS, ROOT, arrows, circles, rooms, syntax
from tests.helpers.commands import run_python, succeed


def test_every_room_has_a_floor() -> None:
    assert rooms(ROOT / "sabench") == set().union(*FLOORS)


def test_imports_go_down() -> None:
    floor = {room: number for number, names in enumerate(FLOORS, 1) for room in names}
    pairs = sorted(arrows(ROOT / "sabench", files=True))
    floors = [[floor[file.split(".")[1]] for file in pair] for pair in pairs]
    assert not [pair for pair, (own, other) in zip(pairs, floors, strict=True) if other > own]


@pytest.mark.parametrize("files", [False, True])
def test_no_circle_of_rooms_or_files(files: bool) -> None:
    assert not circles(arrows(ROOT / "sabench", files=files))


def test_nothing_imports_what_is_mounted_by_its_dotted_name() -> None:
    mounted = {"solvers", "generators", "reproduction"}
    found = {file: imported(file) for file in (ROOT / "sabench").rglob("*.py")}
    assert not {
        (str(file), name)
        for file, names in found.items()
        for name in names
        if name.split(".")[0] in mounted
    }


ALLOWED = {
    "solvers": {"sabench.api", "sabench.algorithms"},
    "generators": {"sabench.api", "sabench.algorithms", "sabench.worlds.library"},
}
ADAPTERS = {"openlpt", "optv"}  # of other programs: also sabench.interop
PLUG_INS = [file for kind in ALLOWED for file in sorted((ROOT / kind).glob("[a-z]*.py"))]
NAMES = ("solvers/min_los.py", "generators/lattice.py")
EXAMPLES = [ROOT / "examples" / "plugins" / name for name in NAMES]


def imported(file: Path) -> set[str]:
    found = set()
    for node in ast.walk(syntax(file)):
        if isinstance(node, ast.ImportFrom) and not node.level:
            found.add(str(node.module))
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


@pytest.mark.parametrize("file", PLUG_INS + EXAMPLES, ids=lambda file: file.stem)
def test_a_plug_in_imports_from_public_packages_only_and_not_from_their_modules(file: Path) -> None:
    """Modules of packages may be split and renamed."""
    allowed = ALLOWED["solvers" if file in EXAMPLES else file.parent.name]
    if file.stem in ADAPTERS:
        allowed = allowed | {"sabench.interop"}
    for name in imported(file):
        if name.split(".")[0] == "sabench":
            assert any(name == one or name.startswith(f"{one}.") for one in allowed), name
        if name.startswith(("sabench.api", "sabench.algorithms")):
            assert (ROOT / Path(*name.split("."))).is_dir(), name


def test_packages_of_algorithms_name_their_public_functions() -> None:
    for folder in sorted((ROOT / "sabench" / "algorithms").glob("[a-z]*/")):
        source = (folder / "__init__.py").read_text(encoding="utf-8")
        assert "__all__" in source, folder.name


HEAVY = {"mitsuba", "drjit", "numpy", "scipy", "cv2", "numba", "h5py"}
HEAVY |= {"sabench.plugins.solvers.msa"}
LISTING = """
from typer.testing import CliRunner
from sabench.cli.main import app
out = CliRunner().invoke(app, ['list'])
assert out.exit_code == 0 and 'msa' in out.output, out.output
"""
COMPLETING = """
from sabench import plugins
from sabench.cli import options
assert options.complete_solver('refr') and options.complete_scene('qu') == ['quick']
assert options.complete(lambda: plugins.list_solvers('calibration'))('m') == []
assert options.complete(plugins.list_suites)('c')
"""


@pytest.mark.parametrize(
    ("script", "light"),
    [
        ("import sabench; dir(sabench)", set()),
        ("from sabench import metrics; assert 'quality' in dir(metrics)", set()),
        (LISTING, set()),
        (COMPLETING, set()),
        ("import sabench.api", {"numpy", "scipy"}),  # as plug-ins do
    ],
)
def test_what_starts_quickly_loads_nothing_heavy_and_no_plug_in(
    script: str, light: set[str]
) -> None:
    report = f"{script}\nimport sys; print('loaded', *({HEAVY - light!r} & set(sys.modules)))"
    assert succeed(run_python("-W", "error", "-c", report)).stdout.splitlines()[-1] == "loaded"
