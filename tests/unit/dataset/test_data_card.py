"""Data card, index and Croissant metadata of samples."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from sabench.dataset.sample_set import SampleSet
from tests.helpers.sample_sets import COUNT, make


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> SampleSet:
    return make(tmp_path_factory.mktemp("samples") / "set")


def test_the_index_tells_where_each_sample_lies(samples: SampleSet) -> None:
    with (samples.root / "samples.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == COUNT
    for row, one in zip(rows, samples, strict=True):
        assert int(row["number"]) == one.number
        assert row["shard"].startswith(row["split"])
        assert int(row["row"]) == one._row


def test_the_card_counts_the_samples(samples: SampleSet) -> None:
    text = (samples.root / "README.md").read_text()
    for name, count in samples.splits.items():
        assert f"| {name} | {count} |" in text
    assert "2 frame(s) by 4 camera(s) of 48 x 64 pixels" in text


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of rdflib
def test_mlcroissant_finds_no_fault_and_reads_the_index(samples: SampleSet) -> None:
    croissant = pytest.importorskip("mlcroissant", reason="mlcroissant is not installed")
    file = samples.root / "croissant.json"
    data = croissant.Dataset(jsonld=file)
    assert not data.metadata.ctx.issues.errors
    rows = list(data.records("samples"))
    assert [int(row["samples/number"]) for row in rows] == [one.number for one in samples]


def test_croissant_names_all_shards(samples: SampleSet) -> None:
    values = json.loads((samples.root / "croissant.json").read_text())
    sets = {one["name"]: one for one in values["distribution"]}
    for side in ("observation", "truth"):
        found = set(samples.root.glob(sets[side]["includes"]))
        assert found == set(Path(samples.root / side).iterdir())
