"""Imports go down the floors, in no circle; plug-ins use public packages; light ones stay light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.architecture.plan import FLOORS, ROOT, arrows, circles, rooms


def test_every_room_has_a_floor() -> None:
    assert rooms(ROOT / "sabench") == set().union(*FLOORS)


def test_imports_go_down() -> None:
    floor = {room: number for number, names in enumerate(FLOORS, 1) for room in names}
    up = [
        f"{one} (floor {floor[one.split('.')[1]]}) imports "
        f"{other} (floor {floor[other.split('.')[1]]})"
        for one, other in sorted(arrows(ROOT / "sabench", files=True))
        if floor[other.split(".")[1]] > floor[one.split(".")[1]]
    ]
    assert not up, "\n".join(up)


def test_no_circle_of_rooms() -> None:
    assert not circles(arrows(ROOT / "sabench"))


def test_no_circle_of_files() -> None:
    assert not circles(arrows(ROOT / "sabench", files=True))


def test_nothing_imports_what_is_mounted_by_its_dotted_name() -> None:
    mounted = {"solvers", "generators", "reproduction"}
    found = []
    for file in sorted((ROOT / "sabench").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                names = [str(node.module)]
            found += [f"{file}: {name}" for name in names if name.split(".")[0] in mounted]
    assert not found


ALLOWED = {
    "solvers": {"sabench.api", "sabench.algorithms"},
    "generators": {"sabench.api", "sabench.algorithms", "sabench.worlds.library"},
}
ADAPTERS = {"openlpt", "optv"}  # of other programs: also sabench.interop
PLUG_INS = [file for kind in ALLOWED for file in sorted((ROOT / kind).glob("[a-z]*.py"))]


def imported(file: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            found.add(str(node.module))
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name for name in found if name.split(".")[0] == "sabench"}


@pytest.mark.parametrize("file", PLUG_INS, ids=lambda file: file.stem)
def test_a_plug_in_imports_from_the_public_packages_only(file: Path) -> None:
    allowed = ALLOWED[file.parent.name]
    if file.stem in ADAPTERS:
        allowed = allowed | {"sabench.interop"}
    for name in imported(file):
        assert any(name == one or name.startswith(f"{one}.") for one in allowed), name


@pytest.mark.parametrize("file", PLUG_INS, ids=lambda file: file.stem)
def test_a_plug_in_imports_from_packages_not_from_their_modules(file: Path) -> None:
    """Plug-ins import from `sabench.algorithms.refocus`, not from a module inside it. These modules
    may be split and renamed."""
    for name in imported(file):
        if name.startswith(("sabench.api", "sabench.algorithms")):
            assert (ROOT / Path(*name.split("."))).is_dir(), name


def test_packages_of_algorithms_name_their_public_functions() -> None:
    for folder in sorted((ROOT / "sabench" / "algorithms").glob("[a-z]*/")):
        source = (folder / "__init__.py").read_text(encoding="utf-8")
        assert "__all__" in source, folder.name


HEAVY = {
    *("mitsuba", "drjit", "numpy", "scipy", "cv2", "numba", "h5py", "sabench.plugins.solvers.msa")
}


def loaded(script: str) -> set[str]:
    report = f"{script}\nimport sys; print('loaded', *({HEAVY!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", report],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split()[1:])


def test_importing_sabench_loads_nothing_heavy() -> None:
    assert not loaded("import sabench; dir(sabench)")


def test_listing_imports_no_plug_in_and_no_numerical_library() -> None:
    script = """
from typer.testing import CliRunner
from sabench.cli.main import app
out = CliRunner().invoke(app, ['list'])
assert out.exit_code == 0 and 'msa' in out.output, out.output
"""
    assert not loaded(script)


def test_names_for_completion_import_no_plug_in() -> None:
    script = """
from sabench import plugins
from sabench.cli import options
assert options.complete_solver('refr') and options.complete_scene('qu') == ['quick']
assert options.complete(lambda: plugins.list_solvers('calibration'))('m') == []
assert options.complete(plugins.list_suites)('c')
"""
    assert not loaded(script)


def test_what_plug_ins_import_loads_no_renderer() -> None:
    assert not loaded("import sabench.api") & {"mitsuba", "drjit", "cv2", "numba", "h5py"}
