"""Description of a data set in the record of a submission.

It discloses neither scene nor seed of a private test set: its content hash identifies it.
"""

from __future__ import annotations

from sabench.dataset.reader import Dataset
from sabench.dataset.schema import Manifest
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import same_data
from sabench.evaluation.suite_loading import is_public
from sabench.utils.progress import console

# keys of a record that describe the data set
_CASE = (
    "suite",
    "case",
    "scene",
    "difficulty",
    "axis",
    "axes",
    "scene_hash",
    "seed",
    "split",
    "renderer",
)


def describe_data(data: Dataset, known: list[Record]) -> Record:
    """Describe the data set of a record.

    The values are those of a run's record of the same data set, if there is one. Else they are
    those of its manifest, but only if its scene and seed are public.
    """
    runs = [one for one in known if not one["submission"] and not one["recorded"]]
    here = {"dataset": data.content_hash, "identity": data.identity}
    twin = next((record for record in runs if same_data(record, here)), None)
    if twin:
        return {key: twin.get(key) for key in _CASE if key in twin}
    manifest = data.manifest
    if not _is_public(manifest, runs):
        return _undisclosed(data)
    return {
        "case": manifest.scene,
        "scene": manifest.scene,
        "axes": {},
        "scene_hash": manifest.scene_hash,
        "seed": manifest.seed,
        "split": "public",
        "renderer": manifest.renderer,
    }


def _is_public(manifest: Manifest, runs: list[Record]) -> bool:
    """Check whether a data set's scene and seed are public already."""
    recorded = any(
        (one["scene_hash"], one["seed"], one["split"])
        == (manifest.scene_hash, manifest.seed, "public")
        for one in runs
    )
    return recorded or is_public(manifest.scene_hash, manifest.seed)


def _undisclosed(data: Dataset) -> Record:
    """Describe a private data set by its content hash alone."""
    name = f"private-{data.content_hash[:12]}"
    reason = "no public record and no bundled suite has its scene with its seed"
    text = f"{data.root}: recorded as {name}: {reason}"
    console.print(text, markup=False, highlight=False, soft_wrap=True)
    return {
        "case": name,
        "scene": "private",
        "axes": {},
        "scene_hash": data.content_hash,
        "seed": 0,
        "split": "hidden",
        "renderer": data.manifest.renderer,
    }
