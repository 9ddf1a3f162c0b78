"""Frames made as they are read."""

import itertools
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sabench
from sabench.dataset.shards import split_names, split_of
from sabench.scenes import Scene, find, parse_scene
from sabench.scenes.variation import Draw, Vary, draw_values
from sabench.simulation.in_memory import simulate
from sabench.simulation.recording import parts
from sabench.simulation.shard_job import Sample, stream, stream_key
from sabench.utils.errors import InputError
from tests.helpers.commands import run_python
from tests.helpers.refusals import check_sentence, refused


def make_scene(**changes: Any) -> Scene:
    values = tomllib.loads(find("quick", "scenes").read_text(encoding="utf-8"))
    values["cameras"] |= {"rows": 48, "columns": 64}
    values["volume"]["size_mm"] = [6.0, 5.0, 4.0]
    values["grid"]["crop_mm"] = [0.0, 0.0, 0.0]
    values["illumination"]["scattering"] = "isotropic"
    for key, change in changes.items():
        values[key] = values.get(key, {}) | change if isinstance(change, dict) else change
    return parse_scene(values, "small")


def vary(impossible: str = "refuse", **draws: Any) -> dict[str, Any]:
    named = {key.replace("__", "."): value for key, value in draws.items()}
    return {"draw": named, "impossible": impossible}


VARIED: dict[str, Any] = {
    "particles__count": {"choices": [20, 30, 40]},
    "sensor__read_noise_e": {"uniform": [1.0, 9.0]},
    "cameras__f_number": {"log_uniform": [8.0, 32.0]},
}


def all_samples(scene: Scene, **options: Any) -> list[Sample]:
    given = {"seed": 4, "samples": 12} | options
    return [one for batch in stream(scene, **given) for one in batch.samples]


@pytest.mark.slow_but_first
@pytest.mark.parametrize("varied", [False, True])
def test_a_stream_goes_on_anywhere_bit_for_bit_with_any_batch(varied: bool) -> None:
    scene = make_scene(**({"vary": vary(**VARIED)} if varied else {}))
    whole = all_samples(scene, samples=20)
    assert [one.number for one in whole] == list(range(20))
    rng = np.random.default_rng(1)
    for start, batch in zip(rng.integers(0, 20, 20).tolist(), itertools.cycle([1, 3, 7])):
        for one in next(stream(scene, seed=4, batch=batch, start=start, samples=20)).samples:
            np.testing.assert_array_equal(one.images, whole[one.number].images)
            assert one.drawn == whole[one.number].drawn


def test_a_sample_is_what_simulate_makes_of_its_seed() -> None:
    for one in all_samples(make_scene(), samples=2):
        shot = simulate(one.scene, seed=one.seed)
        np.testing.assert_array_equal(one.observation().images, shot.observation.images)
        np.testing.assert_array_equal(one.particles[0].position_mm, shot.particles.position_mm)


def test_samples_differ_and_seeds_differ() -> None:
    scene = make_scene()
    first, second = all_samples(scene, samples=2)
    (other,) = all_samples(scene, samples=1, seed=5)
    for one in (second, other):
        assert not np.array_equal(first.particles[0].position_mm, one.particles[0].position_mm)
        assert not np.array_equal(first.images, one.images)


def test_values_that_vary_are_in_the_scene_and_in_the_truth() -> None:
    batch = next(stream(make_scene(vary=vary(**VARIED)), seed=4, batch=12, samples=12))
    assert batch.images.shape == (12, 1, 4, 48, 64)
    assert batch.drawn["particles.count"].shape == (12,)
    assert len(np.unique(batch.drawn["sensor.read_noise_e"])) == 12
    for one in batch.samples:
        assert one.scene.sensor.read_noise_e == one.drawn["sensor.read_noise_e"]
        assert len(one.particles[0].position_mm) == one.drawn["particles.count"]
        assert one.rig.cameras[0].f_number == one.drawn["cameras.f_number"]
        assert one.scene.vary is None
        assert one.redrawn == 0


def test_draws_follow_their_distributions() -> None:
    table = Vary.model_validate(
        vary(a={"uniform": [2.0, 4.0]}, b={"log_uniform": [1.0, 100.0]}, c={"choices": ["x", "y"]})
    )
    draws = [draw_values(table, 1, number, 0) for number in range(4000)]
    a, b = np.array([one["a"] for one in draws]), np.log10([one["b"] for one in draws])
    assert ((a >= 2.0) & (a < 4.0) & (b >= 0.0) & (b < 2.0)).all()
    assert a.mean() == pytest.approx(3.0, abs=0.04)
    assert b.mean() == pytest.approx(1.0, abs=0.04)
    assert np.mean([one["c"] == "x" for one in draws]) == pytest.approx(0.5, abs=0.04)
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.06
    assert Draw(uniform=(1.0, 2.0)).value(0.0) == 1.0
    assert Draw(choices=("a", "b")).value(np.nextafter(1.0, 0.0)) == "b"


def test_displacements_are_those_of_the_flow() -> None:
    flow = {"generator": "linear_flow", "velocity_mm_s": [10.0, 0.0, -5.0]}
    batch = next(stream(make_scene(flow=flow, frames=2, interval_s=0.01), batch=2, samples=2))
    assert batch.images.shape[1] == 2
    for position, moved in batch.displacements_mm():
        assert len(position) > 200
        np.testing.assert_allclose(moved, np.tile([0.1, 0.0, -0.05], (len(moved), 1)), atol=1e-9)


def test_splits_are_disjoint_stable_and_as_large_as_asked() -> None:
    scene, shares = make_scene(), (80, 10, 10)
    names = [split_of(number, shares) for number in range(20_000)]
    for name, share in zip(split_names(3), shares, strict=True):
        assert names.count(name) / 20_000 == pytest.approx(share / 100, abs=0.01)
    parts = {
        name: [one.number for one in all_samples(scene, samples=40, split=(name, shares))]
        for name in split_names(3)
    }
    assert sorted(itertools.chain(*parts.values())) == list(range(40))
    longer = [one.number for one in all_samples(scene, samples=80, split=("test", shares))]
    assert longer[: len(parts["test"])] == parts["test"]
    assert split_names(4) == ["train", "validation", "test", "split-3"]


BEHIND: dict[str, Any] = {"choices": [[0.0, 0.0, -50.0]]}  # where the range would put the wall


def test_impossible_samples_are_refused_and_so_is_a_range_without_any_scene() -> None:
    with refused("vary", "volume.center_mm"):
        stream(make_scene(vary=vary(volume__center_mm=BEHIND)))
    with refused("sample 0"):
        all_samples(make_scene(vary=vary("redraw", volume__center_mm=BEHIND)))


def test_impossible_samples_are_drawn_again_and_counted() -> None:
    center = list(make_scene().volume.center_mm)
    choices = {"choices": [center, [0.0, 0.0, -50.0]]}
    samples = all_samples(make_scene(vary=vary("redraw", volume__center_mm=choices)))
    assert all(list(one.scene.volume.center_mm) == center for one in samples)
    assert 3 <= sum(one.redrawn for one in samples) <= 40


@pytest.mark.parametrize(
    ("key", "drawn"),
    [
        ("particles.count", {}),
        ("particles.count", {"uniform": [1, 2], "choices": [1]}),
        ("particles.count", {"uniform": [2, 1]}),
        ("partcles", {"choices": [1]}),
        ("cameras.rows", {"choices": [48]}),
        ("frames", {"choices": [1, 2]}),
        ("sensor.red_noise_e", {"uniform": [1.0, 2.0]}),  # found with the first sample
    ],
)
def test_faults_of_what_varies_are_named_with_their_key(key: str, drawn: dict[str, Any]) -> None:
    name = "partcles.count" if key == "partcles" else key
    with refused(key):
        stream(make_scene(vary={"draw": {name: drawn}}))


@pytest.mark.parametrize(
    ("key", "options"),
    [
        ("batch", {"batch": 0}),
        ("start", {"start": -1}),
        ("'dev'", {"split": ("dev", (80, 20))}),
        ("split", {"split": ("train", (-1, 2))}),
        ("split", {"split": ("train", (0, 1))}),
        ("split", {"split": "train"}),
        ("samples", {"start": 5, "samples": 4}),
        ("backend", {"backend": "gpu"}),
    ],
)
def test_wrong_options_are_refused(key: str, options: dict[str, Any]) -> None:
    with refused(key):
        stream(make_scene(), **options)


def test_other_scenes_and_cameras_that_differ_in_number_are_refused() -> None:
    with refused():
        stream("standard-bubbles")
    scene = make_scene(vary=vary(cameras__layout__columns={"choices": [1, 2]}))
    with refused():
        next(stream(scene, batch=12))


def test_one_data_set_has_no_values_that_vary(tmp_path: Path) -> None:
    scene = make_scene(vary=vary(**VARIED))
    with refused("sabench.stream"):
        simulate(scene)
    with refused("sabench.stream"):
        sabench.generate(scene, tmp_path / "data", seed=1)
    assert not list(tmp_path.iterdir())


def test_a_stream_of_other_scene_or_version_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, other = make_scene(), make_scene(sensor={"read_noise_e": 2.0})
    key = stream_key(scene, seed=3)
    next(stream(scene, seed=3, start=5, key=key))
    for one, seed in ((other, 3), (scene, 4), (scene, 3)):
        if (one, seed) == (scene, 3):
            monkeypatch.setattr(parts, "code_hash", lambda: "of another version")
        with pytest.raises(InputError) as end:
            stream(one, seed=seed, start=5, key=key)
        check_sentence(re.sub(r"\b[0-9a-f]{12}\b", "KEY", str(end.value)))


STREAM = """
import sys
import numpy as np
from sabench.utils import backend
print(backend.choose().kind)
from tests.unit.simulation.test_streaming import all_samples, make_scene
scene = make_scene(illumination={"pulse_energy_mj": 0.6})  # no pixel is full
samples = all_samples(scene, samples=2, backend="mitsuba")
np.save(sys.argv[1], [one.images for one in samples])
"""


@pytest.mark.slow
def test_a_traced_stream_is_what_simulate_traces_and_as_bright_as_the_analytic_one() -> None:
    scene = make_scene(illumination={"pulse_energy_mj": 0.6})  # no pixel is full
    traced = all_samples(scene, samples=2, backend="mitsuba")
    for one, splat in zip(traced, all_samples(scene, samples=2), strict=True):
        shot = simulate(one.scene, seed=one.seed, backend="mitsuba")
        np.testing.assert_array_equal(one.images[0], shot.observation.images)
        np.testing.assert_array_equal(one.particles[0].position_mm, splat.particles[0].position_mm)
        dark = scene.sensor.black_level_dn * one.images.size
        assert one.images.max() < scene.sensor.white_dn
        assert one.images.sum() - dark == pytest.approx(splat.images.sum() - dark, rel=1e-3)


def test_a_traced_stream_on_a_gpu_is_that_on_llvm(tmp_path: Path) -> None:
    made = []
    for kind in ("cuda", "llvm"):
        file = tmp_path / f"{kind}.npy"
        done = run_python("-c", STREAM, file, env={"SABENCH_BACKEND": kind})
        if kind == "cuda" and not done.stdout:
            pytest.skip("needs a CUDA device")
        assert done.returncode == 0, done.stderr
        made.append(np.load(file).astype(float))
    # single precision rounds rays differently: light by less than a grey value
    apart = np.abs(made[0] - made[1])
    assert apart.max() <= 1.0
    assert (apart > 0.0).mean() < 0.02
    assert made[0].sum() == pytest.approx(made[1].sum(), rel=1e-5)
