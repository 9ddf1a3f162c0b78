"""Compare data sets made with different instruction sets of x86-64, array by array.

    python -m benchmarks.instruction_sets [-o FOLDER] [--case NAME ...] [--variant NAME ...]

A child process for each variant makes the data sets; variables of the environment limit one
library each (numba, OpenBLAS, NumPy, the C library, OpenCV, Dr.Jit), the last variant all of them.
Embree, which finds the surfaces that rays of bubbles and targets meet, cannot be limited.
`docs/developing/decisions.md` holds a summary of the table that this prints. The exit code
is 1 if copies have other identities or do not agree.
"""

import argparse
import ctypes
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.dataset.copies import disagreements
from sabench.dataset.reader import open_dataset
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.utils.backend import Renderer
from sabench.utils.files import read_json

Make = Callable[[], tuple[Scene, Renderer]]
BASE = "this processor"
_DRJIT = "SABENCH_TEST_LLVM_TARGET"  # of this program
_NUMPY = "X86_V4 AVX512_ICL AVX512_SPR"
_GLIBC = "glibc.cpu.hwcaps=-AVX512F,-AVX2,-AVX,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable"
_OPENCV = "AVX512-SKX,AVX512-ICL,AVX512F,AVX2,FMA3,AVX,FP16"
ONE_THREAD = {
    "NUMBA_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
}
SMALL = {  # each library as on a processor without AVX
    "numba": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "OpenBLAS": {"OPENBLAS_CORETYPE": "Nehalem"},
    "NumPy": {"NPY_DISABLE_CPU_FEATURES": f"X86_V3 {_NUMPY}"},
    "C library": {"GLIBC_TUNABLES": _GLIBC},
    "OpenCV": {"OPENCV_CPU_DISABLE": _OPENCV},
    "Dr.Jit": {_DRJIT: "haswell:+avx2,+fma:4"},  # it needs fused multiply-adds
}
MIDDLE = {  # AVX2 and fused multiply-adds, without AVX-512
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma,+bmi,+bmi2,+sse4.2,+popcnt",
    "OPENBLAS_CORETYPE": "Haswell",
    "NPY_DISABLE_CPU_FEATURES": _NUMPY,
    _DRJIT: "haswell:+avx2,+fma:8",
}
VARIANTS: dict[str, dict[str, str]] = {
    BASE: {},
    "again": {},
    "one thread": ONE_THREAD,
    "AVX2": MIDDLE,
    **SMALL,
    "all": {key: value for part in SMALL.values() for key, value in part.items()},
}


def _named(name: str, renderer: Renderer = "auto", **tables: Any) -> Make:
    def make() -> tuple[Scene, Renderer]:
        values = load_scene(name).to_dict()
        for key, value in tables.items():
            values[key] = {**values[key], **value} if isinstance(value, dict) else value
        return parse_scene(values, name), renderer

    return make


def _flow(generator: str, **parameters: Any) -> Make:
    def make() -> tuple[Scene, Renderer]:
        values = load_scene("quick").to_dict()
        values |= {"frames": 2, "flow": {"generator": generator, **parameters}}
        return parse_scene(values, generator), "splat"

    return make


_CONFORMANCE = (
    "reconstruction",
    "particles",
    "velocimetry",
    "calibration",
    "calibration_by_particles",
    "bubbles",
    "see_through",
)
_SMALL_CAMERAS = {"rows": 300, "columns": 300, "pixel_mm": 0.04}
CASES: dict[str, Make] = {
    **{name: _named(f"scenes/conformance/{name}.toml") for name in _CONFORMANCE},
    "quick splat": _named("quick", "splat"),
    "quick mitsuba": _named("quick", "mitsuba"),
    "target": _named("calibration-boards", "mitsuba", frames=3, cameras=_SMALL_CAMERAS),
    "vortex ring": _flow("vortex_ring"),
    "turbulence": _flow("turbulence"),
}


@dataclass
class Difference:
    """Arrays of one name that differ: how many of the values, and by how much."""

    values: int = 0
    different: int = 0
    largest: float = 0.0
    relative: float = 0.0  # to the largest value of the array
    cases: set[str] = field(default_factory=set)

    def add(self, case: str, one: npt.NDArray[Any], other: npt.NDArray[Any]) -> None:
        """Add one array of two data sets."""
        self.values += one.size
        if one.shape != other.shape:
            self.different, self.largest = self.different + one.size, np.inf
            self.cases.add(case)
            return
        same = (one == other) | (_nan(one) & _nan(other))
        if same.all():
            return
        self.cases.add(case)
        gap = np.abs(one.astype(float) - other.astype(float))[~same]
        gap = np.where(np.isnan(gap), np.inf, gap)
        self.different += int((~same).sum())
        self.largest = max(self.largest, float(gap.max()))
        size = float(np.nanmax(np.abs(one.astype(float)), initial=0.0)) or 1.0
        self.relative = max(self.relative, float(gap.max()) / size)


def _nan(value: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    return np.isnan(value) if value.dtype.kind == "f" else np.zeros(value.shape, bool)


def compare(one: Path, other: Path, case: str, found: dict[str, Difference]) -> None:
    """Compare all arrays of two data sets."""
    first, second = dict(arrays(one)), dict(arrays(other))
    if first.keys() != second.keys():
        raise SystemExit(f"{other}: other arrays than {one}: {first.keys() ^ second.keys()}")
    for name, value in first.items():
        found.setdefault(_kind(name), Difference()).add(case, value, second[name])


def _kind(name: str) -> str:
    """Name an array without the numbers of its frame, camera and body."""
    return re.sub(r"(frame_|frames/|camera_|bodies/)\d+", r"\1*", name).replace("_*", "")


def arrays(root: Path) -> Iterator[tuple[str, npt.NDArray[Any]]]:
    """List the arrays of all files of a data set but those of the manifest."""
    from sabench.images.tiff_exr import read_exr, read_tiff

    cameras = read_json(root / "cameras.json")["cameras"]
    shape = cameras[0]["rows"], cameras[0]["columns"]
    for path in sorted(one for one in root.rglob("*") if one.is_file()):
        name = path.relative_to(root).as_posix()
        if path.suffix == ".h5":
            yield from _hdf5(path, name)
        elif path.suffix == ".tif":
            yield name, read_tiff(path, shape)
        elif path.suffix == ".exr":
            yield name, read_exr(path, shape)
        elif path.suffix == ".json" and name != "manifest.json":
            yield name, np.array(list(_numbers(read_json(path))))


def _hdf5(path: Path, name: str) -> Iterator[tuple[str, npt.NDArray[Any]]]:
    import h5py

    found: list[tuple[str, npt.NDArray[Any]]] = []

    def visit(key: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset):
            found.append((f"{name}:{key}", node[...]))

    with h5py.File(path) as file:
        file.visititems(visit)
    yield from found


def _numbers(value: Any) -> Iterator[float]:
    """List the numbers of a JSON value."""
    if isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _numbers(one)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)


def make_all(folder: Path, cases: list[str]) -> None:
    """Make the data sets of one variant, in its own process."""
    from sabench.simulation.pipeline import generate

    limit_drjit()
    for case in cases:
        scene, renderer = CASES[case]()
        made = generate(scene, folder / case, seed=1, backend=renderer, name=case)
        print(f"{folder.name}: {case}: {made.content_hash[:12]}", flush=True)


def limit_drjit() -> None:
    """Compile Dr.Jit's kernels for the processor that the environment names."""
    target = os.environ.get(_DRJIT)
    if target is None:
        return
    from sabench.utils.backend import drjit

    dr, arrays_of = drjit()
    dr.eval(arrays_of.Float([1.0]) + 1.0)  # starts the back end
    library = ctypes.CDLL(str(Path(dr.__file__).parent / "libdrjit-core.so"))
    cpu, features, width = target.split(":")
    library._Z19jit_llvm_set_targetPKcS0_j(cpu.encode(), features.encode() or None, int(width))


def environment(variant: str, folder: Path) -> dict[str, str]:
    """Compose the environment of one variant; what it compiles stays in its own folder."""
    limits = VARIANTS[variant]
    cache = folder / ".caches" / variant
    (cache / "home").mkdir(parents=True, exist_ok=True)
    own = {
        "NUMBA_CACHE_DIR": str(cache / "numba"),
        "DRJIT_CACHE_DIR": str(cache / "drjit"),
        "HOME": str(cache / "home"),
    }
    return {**os.environ, **own, **limits}


def table(found: dict[str, dict[str, Difference]]) -> Iterator[str]:
    """Format the differences as a table of Markdown."""
    yield "| instructions | array | values that differ | largest difference | relative | cases |"
    yield "|---|---|---|---|---|---|"
    for variant, own in found.items():
        rows = {name: one for name, one in own.items() if one.different}
        if not rows:
            yield f"| {variant} | none | 0 | 0 | 0 | |"
        for name, one in rows.items():
            share = f"{one.different} of {one.values}"
            cases = ", ".join(sorted(one.cases))
            yield (
                f"| {variant} | `{name}` | {share} | {one.largest:.1e} | {one.relative:.1e} | "
                f"{cases} |"
            )


def main() -> None:
    """Make the data sets of every variant and print what differs from this processor's."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("-o", "--output", type=Path, default=Path("work/instruction_sets"))
    parser.add_argument("--case", action="append", choices=[*CASES])
    parser.add_argument("--variant", action="append", choices=[*VARIANTS])
    parser.add_argument("--make", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    cases, folder = chosen.case or [*CASES], chosen.output.absolute()
    if chosen.make:
        make_all(folder / chosen.make, cases)
        return
    variants = list(dict.fromkeys([BASE, *(chosen.variant or VARIANTS)]))
    found: dict[str, dict[str, Difference]] = {}
    faults: list[str] = []
    for variant in variants:
        missing = [case for case in cases if not (folder / variant / case).is_dir()]
        command = [sys.executable, "-m", "benchmarks.instruction_sets", "-o", str(folder)]
        for case in missing:
            command += ["--case", case]
        if missing:
            subprocess.run(
                [*command, "--make", variant], env=environment(variant, folder), check=True
            )
        if variant != BASE:
            found[variant] = {}
            for case in cases:
                one, other = folder / BASE / case, folder / variant / case
                compare(one, other, case, found[variant])
                faults += disagreements(open_dataset(one), open_dataset(other))
    print("\n".join([*table(found), "", *faults, f"{len(faults)} disagreements"]))
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
