"""Damaged input from outside for the functions behind the commands that read it."""

import json
import random
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import tomli_w

from sabench import tasks
from sabench.api import Detections, Velocity
from sabench.api.solvers import TaskName
from sabench.dataset import schema
from sabench.dataset.copies import copy_observation
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import Result, result_writer
from sabench.dataset.verification import probe, probe_dataset, verify
from sabench.evaluation.leaderboard.submissions import submit
from sabench.evaluation.runner import build_board
from sabench.evaluation.suite_loading import load_suite
from sabench.interop.export import export
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.simulation.pipeline import generate
from sabench.tasks.external_programs import write_anew
from sabench.tasks.solve_and_score import run_plug_in, score, solve
from sabench.utils.errors import InputError
from sabench.utils.files import sha256
from tests.helpers import mutations, untrusted_files
from tests.helpers.bubble_scenes import CURTAIN, PLATE, VOLUME, few_pixels, small

SCENE = tomllib.loads("""
title = "tiny"
frames = 2
volume = { center_mm = [0.0, 0.0, 30.0], size_mm = [3.0, 2.0, 1.0] }
grid = { voxel_mm = [0.1, 0.1, 0.2], crop_mm = [0.2, 0.1, 0.0] }
[wall]
point_mm = [0.0, 0.0, 0.0]
normal = [0.0, 0.0, 1.0]
fluid_index = 1.333
layers = [{ index = 1.52, thickness_mm = 5.0 }]
[cameras]
rows = 24
columns = 32
pixel_mm = 0.02
focal_length_mm = 85.0
f_number = 16.0
center_mm = [0.0, 0.0, -490.0]
layout = { kind = "grid", columns = 2, rows = 1, spacing_mm = [240.0, 240.0] }
[illumination]
pulse_energy_mj = 60.0
direction = [1.0, 0.0, 0.0]
sheet_normal = [0.0, 0.0, 1.0]
thickness_mm = 5.0
height_mm = 20.0
scattering = "isotropic"
[particles]
generator = "uniform"
count = 8
diameter_mm = 0.02
diameter_spread = 0.1
[sensor]
read_noise_e = 6.0
full_well_e = 18000.0
gain_dn_e = 0.22
black_level_dn = 64.0
bit_depth = 12
""")
EXTRAS = tomllib.loads("""
flow = { generator = "shear_wave", amplitude_mm_s = 5.0, wavelength_mm = 8.0 }
timing = { rate_hz = 10.0, pulses_s = [0.0, 0.001] }
occluders = [{ center_mm = [10.0, 0.0, -20.0], radius_mm = 1.0 }]
calibration = { shift_px = 0.5, unknown = ["k1", "principal_point"] }
preprocessing = [
  { step = "sliding_minimum", window_px = 5 },
  { step = "gaussian", reach_px = 2, sigma_px = 1.0 },
]
render = { samples_per_pixel = 4 }
""")
_THREE = {"kind": "grid", "columns": 3, "rows": 1, "spacing_mm": [240.0, 240.0]}
TARGETS: dict[str, Any] = {
    **{key: value for key, value in SCENE.items() if key not in ("particles", "illumination")},
    "title": "board",
    "frames": 4,
    "cameras": {**SCENE["cameras"], "layout": _THREE},
    "targets": {"generator": "boards", "columns": 5, "rows": 4, "pitch_mm": 0.4},
    "detection": {"noise_px": 0.1},
}
_CURTAIN = {key: value for key, value in CURTAIN.items() if key != "radius_spread"}
CODE: dict[str, Any] = {
    "volume": VOLUME,
    "grid": {"voxel_mm": [0.5, 0.5, 2.0]},
    "bubbles": {**_CURTAIN, "count": 3},
    "solids": [PLATE],
    "render": {"relative_error": 0.2},
    "cameras": few_pixels(36, 48, 0.06),
}
SUITE = tomllib.loads("""
title = "tiny suite"
scenes = ["scene.toml"]
seeds = [1, 2]
backend = "splat"
set = { frames = 1 }
vary = { "particles.count" = [3, 5] }
[[solvers]]
name = "asa"
parameters = { k = 3.0 }
[[solvers]]
name = "./program"
task = "reconstruction"
time_limit_s = 5.0
""")
# work, as `steps_of` estimates it, of scenes that are generated and not only checked
LARGEST_STEPS = 4e6


@dataclass(frozen=True)
class Base:
    """Intact data that cases damage. Data sets of particles, of a target and of a code behind
    bubbles, results of all tasks, a line of a leaderboard, files of other programs, and the folder
    of an interrupted generation."""

    particles: Dataset
    target: Dataset
    code: Dataset
    results: dict[str, Path]
    record: dict[str, Any]
    files: dict[str, Path]
    interrupted: Path

    def data_of(self, task: str) -> Dataset:
        own = {"calibration": self.target, "bubbles": self.code, "see_through": self.code}
        return own.get(task, self.particles)


def make_base(root: Path) -> Base:
    made = [
        generate(parse_scene(scene, name), root / name, seed=1, backend="splat", name=name)
        for scene, name in ((SCENE, "particles"), (TARGETS, "target"))
    ]
    made.append(generate(small(**CODE), root / "code", seed=1))
    head = {"format": "sabench-record", "version": 2, "task": "reconstruction", "seed": 1}
    case = {"scene": "tiny", "case": "tiny", "axes": {"particles.count": 3}, "renderer": "splat"}
    hashes = {"scene_hash": "a" * 64, "dataset": made[0].content_hash, "run_hash": "b" * 64}
    own = {"solver": "asa", "label": None, "parameters": {"k": 3.0}, "pictures": "tiny"}
    sent = {"submission": {"name": "Ann", "date": "2026-01-02"}, "versions": {"sabench": "1"}}
    end = {"machine": {"cpu": "x", "cores": 2}, "error": None, "declined": False}
    record = {**head, **case, **hashes, **own, **sent, **end, "q": 0.5, "seconds": 1.0}
    files = untrusted_files.write_fields(root / "files")
    files |= untrusted_files.write_meshes(root / "files")
    files["baseline"] = untrusted_files.write_baseline(root / "files" / "tiny.json")
    interrupted = untrusted_files.interrupt(SCENE, root / "interrupted")
    particles, target, code = made
    base = Base(particles, target, code, {}, record, files, interrupted)
    for task in get_args(TaskName):
        base.results[task] = _result(task, base.data_of(task), root / f"{task}.h5")
    return base


def _estimate(task: TaskName, data: Dataset, frame: int) -> Any:
    rng = np.random.default_rng(1 + frame)
    if task == "bubbles":
        center_mm = rng.random((5, 3)) + np.array([0.0, 0.0, 30.0])
        balls = Detections.balls(center_mm, rng.random(5) + 0.1)
        return replace(balls, trajectory=np.arange(5))
    if task == "velocimetry":
        valid = np.ones((2, 3, 4), dtype=bool)
        return Velocity((-1.0, -0.5, 29.8), (0.5, 0.5, 0.2), rng.random((2, 3, 4, 3)), valid)
    return tasks.of(task).truth(data, frame)


def _result(task: TaskName, data: Dataset, path: Path) -> Path:
    with result_writer(path, data, "made", task, {"k": 1}) as writer:
        for frame in tasks.of(task).frames(data):
            writer.add(_estimate(task, data, frame), frame)
        writer.set(seconds=1.0, peak_mb=2.0)
    return path


Feed = Callable[[], object]
Case = Callable[[Base, Path, Path, random.Random], Feed]


def scene(base: Base, inputs: Path, out: Path, rng: random.Random) -> Feed:
    """Generate a damaged scene; one that is accepted and would take long is only checked."""
    whole = dict(TARGETS if rng.random() < 0.15 else SCENE)
    if "particles" in whole:
        whole |= {key: value for key, value in EXTRAS.items() if rng.random() < 0.2}
    path = inputs / "scene.toml"
    write_toml(path, whole, rng)

    def feed() -> None:
        loaded = load_scene(path)
        if loaded.illumination is not None and loaded.illumination.scattering == "mie":
            return  # its table takes seconds
        if steps_of(loaded) < LARGEST_STEPS and loaded.flow_grid_mm is None:
            generate(path, out / "set", seed=1, backend="splat")

    return feed


def steps_of(loaded: Scene) -> float:
    """Estimate the work of generating a scene: pixels, particles and files of all its images."""
    count = (loaded.particles or {}).get("count") or 0
    images = 0.5 * loaded.cameras.count * loaded.frames
    return images * (loaded.cameras.rows * loaded.cameras.columns + 1000 * count + 50_000)


_MOST_VALUES = 100_000  # of a damaged TOML file


def write_toml(path: Path, whole: dict[str, Any], rng: random.Random) -> None:
    if rng.random() < 0.2:
        path.write_bytes(mutations.data(tomli_w.dumps(whole).encode(), rng))
        return
    damaged = mutations.tree(whole, rng)
    whole = damaged if isinstance(damaged, dict) else {"x": damaged}
    try:
        text = tomli_w.dumps(_without_none(whole, [_MOST_VALUES]))
    except (TypeError, RecursionError):
        text = "x = " + "[" * 5000
    path.write_text(text, encoding="utf-8", errors="surrogatepass")


def _without_none(value: Any, room: list[int]) -> Any:
    """Leave out None; a RecursionError where lists in lists that are one have too many values."""
    room[0] -= 1
    if room[0] < 0:
        raise RecursionError
    if isinstance(value, dict):
        parts = {str(key): part for key, part in value.items() if part is not None}
        return {key: _without_none(part, room) for key, part in parts.items()}
    if isinstance(value, list):
        return [_without_none(part, room) for part in value if part is not None]
    return value


def suite(base: Base, inputs: Path, out: Path, rng: random.Random) -> Feed:
    """Run the checks that `sabench run` makes before it works."""
    (inputs / "scene.toml").write_text(tomli_w.dumps(SCENE))
    program = inputs / "program"
    program.write_text("#!/bin/sh\nexit 3\n")
    program.chmod(0o755)
    write_toml(inputs / "suite.toml", SUITE, rng)
    return lambda: load_suite(inputs / "suite.toml")


def dataset(base: Base, inputs: Path, out: Path, rng: random.Random) -> Feed:
    """Verify, score and solve a data set with a damaged file, mostly with its checksum."""
    source = rng.choice((base.particles, base.particles, base.target, base.code))
    root = Path(shutil.copytree(source.root, inputs / "set"))
    kept = [
        path.relative_to(root).as_posix()
        for path in root.rglob("*")
        if (path.is_file() and path.suffix != ".exr") or rng.random() < 0.3
    ]
    path = root / rng.choice(sorted(kept))
    if path.is_dir():
        path = root / schema.CAMERAS
    _damage(path, rng)
    if rng.random() < 0.8:
        reseal(root)

    solved = _solved_as_users_do if rng.random() < 0.05 else _solved
    return lambda: _all_of((_verified, _probed, _scored, solved, _exported), root, out)


def blind(base: Base, inputs: Path, out: Path, rng: random.Random) -> Feed:
    """Run `sabench verify` and `solve` on a damaged observation side, as participants do."""
    root = inputs / "set"
    root.mkdir()
    copy_observation(rng.choice((base.particles, base.target, base.code)), root)
    _damage(rng.choice(sorted(path for path in root.rglob("*") if path.is_file())), rng)
    if rng.random() < 0.8:
        reseal(root)

    solved = _solved_as_users_do if rng.random() < 0.05 else _solved
    return lambda: _all_of((_verified, _probed, solved), root, out)


def _damage(path: Path, rng: random.Random) -> None:
    if path.suffix == ".json" and rng.random() < 0.8:
        damaged = mutations.tree(json.loads(path.read_text()), rng)
        text = json.dumps(damaged, ensure_ascii=rng.random() < 0.9)
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
    elif path.suffix == ".h5":
        mutations.hdf5(path, rng)
    elif path.suffix == ".toml":
        write_toml(path, tomllib.loads(path.read_text()), rng)
    elif path.suffix == ".tif" and rng.random() < 0.3:
        mutations.tiff(path, rng)
    elif path.suffix == ".exr" and rng.random() < 0.5:
        mutations.exr(path, rng)
    else:
        path.write_bytes(mutations.data(path.read_bytes(), rng))


def reseal(root: Path) -> None:
    """Let the manifest, if it can still be read, say of all files what they are now."""
    try:
        manifest = json.loads((root / schema.MANIFEST).read_text())
        files = {
            path.relative_to(root).as_posix(): {
                "bytes": path.stat().st_size,
                "sha256": sha256(path),
            }
            for path in sorted(root.rglob("*"))
            if path.is_file() and path.name != schema.MANIFEST
        }
        entries = {name: schema.FileEntry(**entry) for name, entry in files.items()}
        new = {"files": files, "content_hash": schema.content_hash(entries)}
        sealed = schema.seal({**manifest, **new})
    except (ValueError, TypeError, AttributeError, OSError, RecursionError):
        return
    (root / schema.MANIFEST).write_text(sealed, encoding="utf-8", errors="surrogatepass")


def _all_of(steps: tuple[Callable[[Path, Path], None], ...], root: Path, out: Path) -> None:
    """Every step is tried; the first refusal counts when all have ended well."""
    refused = None
    for step in steps:
        try:
            step(root, out)
        except InputError as error:
            check_sentence(str(error))
            refused = refused or error
            if "reading it" in str(error):  # the commands read no further then
                break
    if refused:
        raise refused


def _verified(root: Path, out: Path) -> None:
    faults = verify(root)
    for fault in faults:
        check_sentence(fault)
    if faults:
        raise InputError(faults[0])


def _probed(root: Path, out: Path) -> None:
    probe_dataset(root)


def _scored(root: Path, out: Path) -> None:
    check_scores(score(root, "truth"))


def _solved(root: Path, out: Path) -> None:
    solve_here(root, out / "result.h5")
    if open_dataset(root).has_truth:
        check_scores(score(root, out / "result.h5"))


def _solved_as_users_do(root: Path, out: Path) -> None:
    solver, parameters = _fast_solver(root)
    check_scores({"seconds": solve(solver, root, out / "child.h5", parameters=parameters).seconds})


def solve_here(root: Path, out: Path) -> None:
    """Solve a data set by a fast solver, in this process: its child would take half a second."""
    solver, parameters = _fast_solver(root)
    run_plug_in(solver, parameters, root, out, threads=None, isolated=False)


def _fast_solver(root: Path) -> tuple[str, dict[str, Any]]:
    shown = open_dataset(root).shows[-1]
    solver = {"target": "refractive_autocal", "code": "see_through"}.get(shown, "asa")
    return solver, {"k": 3.0} if solver == "asa" else {}


def _exported(root: Path, out: Path) -> None:
    export(root, out / "vtk")


def result(base: Base, inputs: Path, out: Path, rng: random.Random) -> Feed:
    """Score a damaged result, and adopt it as the result of a program."""
    track = rng.choice(sorted(base.results))
    data = base.data_of(track)
    path = Path(shutil.copy(base.results[track], inputs / "result.h5"))
    mutations.hdf5(path, rng)
    if rng.random() < 0.1:  # as if it were one of other data
        data = rng.choice((base.particles, base.target, base.code))
        mutations.set_attribute(path, "dataset", data.content_hash)

    def scored(root: Path, out: Path) -> None:
        check_scores(score(root, path))

    def adopted(root: Path, out: Path) -> None:
        grid = data.setup.grid
        head = Result(path, "particles", "program", {}, 1.0, 2.0, grid, isolated=True)
        write_anew(path, root, out / "adopted.h5", head, False)

    def exported(root: Path, out: Path) -> None:
        export(root, out / "vtk", path)

    def feed() -> None:
        probe(path)  # as both commands do before anything else
        _all_of((scored, adopted, exported), data.root, out)

    return feed


_KEYS = (b"solver", b"paper", b"code", b"licence", b"hardware", b"parameters", b"training_data")
CARD = b"".join(b'%s = "text"\n' % key for key in _KEYS)


def submission(base: Base, inputs: Path, out: Path, rng: random.Random) -> Feed:
    tasks = ("reconstruction", "calibration", "particles", "see_through")
    files = [base.results[task].read_bytes() for task in tasks]
    path = inputs / rng.choice(("a.zip", "a.tar", "a.tar.gz", "a.tgz", "a.h5", "folder"))
    if path.name == "folder":
        path.mkdir()
        (path / "a.h5").write_bytes(
            mutations.data(files[0], rng) if rng.random() < 0.5 else files[0]
        )
        if rng.random() < 0.3:
            (path / "b.h5").symlink_to(rng.choice(("/etc/passwd", "a.h5", "..")))
    elif path.suffix == ".h5":
        path.write_bytes(mutations.data(files[0], rng))
    else:
        mutations.archive(path, files, rng)
    name = rng.choice(
        ("Ann", "Ann", "Ann", "", "x" * 81, "a\nb", "<b>", "é", "\x1b[2J", "[red]", "\ud800")
    )
    cards = [inputs / "my.card.toml"] if rng.random() < 0.3 else []
    for card in cards:
        card.write_bytes(mutations.data(CARD, rng))

    def feed() -> None:
        data = [base.particles.root, base.target.root, base.code.root]
        submit(path, name, data, out / "leaderboard", cards=cards)

    return feed


def records(base: Base, inputs: Path, out: Path, rng: random.Random) -> Feed:
    folder = out / "leaderboard" / "records"
    folder.mkdir(parents=True)
    lines = [json.dumps(base.record)]
    for _ in range(rng.randrange(1, 4)):
        damaged = mutations.tree(base.record, rng)
        text = json.dumps(damaged, ensure_ascii=rng.random() < 0.8)
        line = text.encode("utf-8", "surrogatepass")
        lines.append((mutations.data(line, rng) if rng.random() < 0.2 else line).decode("latin-1"))
    (folder / "a.jsonl").write_bytes(
        "\n".join(lines).encode("latin-1") + rng.choice((b"\n", b"", b"\n{"))
    )
    return lambda: build_board(out / "leaderboard")


KINDS: dict[str, Case] = {
    "scene": scene,
    "suite": suite,
    "dataset": dataset,
    "blind": blind,
    "result": result,
    "submission": submission,
    "records": records,
    **untrusted_files.KINDS,
}


def check_sentence(text: str) -> None:
    """Check that a complaint is one line, or a headline and a short indented line a fault."""
    assert text, "an error without words"
    head, *faults = text.split("\n")
    assert bool(faults) == head.endswith("faults:"), f"an error of several lines: {text[:300]!r}"
    assert all(line.startswith("  ") for line in faults), f"not indented: {text[:300]!r}"
    assert all(len(line) <= 300 for line in faults), f"a fault is too long: {text[:900]!r}"
    assert len(faults) <= 21, f"{len(faults)} faults: {text[:300]!r}"
    assert len(head) <= 1500, f"an error of {len(head)} characters: {head[:300]!r}"


def check_scores(scores: dict[str, Any]) -> None:
    """Scores are numbers that JSON has, and none is better than perfect."""
    json.dumps(scores, allow_nan=False)
    q = scores.get("q")
    assert q is None or -1.000001 <= q <= 1.000001, f"q = {q}"
