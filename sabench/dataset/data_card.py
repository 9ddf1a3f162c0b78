"""Description of a data set of samples for people and for other programs.

README.md is a data card, croissant.json metadata in the format Croissant 1.0
(https://docs.mlcommons.org/croissant/docs/croissant-spec.html), samples.csv an index of samples.
None of them tells anything of the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sabench.dataset import schema
from sabench.dataset.shards import Shard
from sabench.utils.files import canonical_json, sha256

CROISSANT, CARD = "croissant.json", "README.md"
_COLUMNS = {"number": "sc:Integer", "split": "sc:Text", "shard": "sc:Text", "row": "sc:Integer"}
_MEANINGS = {
    "number": "number of the sample",
    "split": "train, validation, test, ...",
    "shard": "name of the files observation/NAME.h5 and truth/NAME.h5",
    "row": "row of the sample in the arrays of its shard, from 0",
}
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}


def write_card(root: Path, head: dict[str, Any], title: str, shards: Sequence[Shard]) -> None:
    """Write all three into a data set in the making.

    Parameters
    ----------
    head : keys of its manifest.
    """
    lines = [
        ",".join(_COLUMNS),
        *(
            [
                f"{number},{shard.split},{shard.name},{row}"
                for shard in shards
                for row, number in enumerate(shard.numbers.tolist())
            ]
        ),
    ]
    (root / schema.INDEX).write_text("\n".join(lines) + "\n", encoding="utf-8")
    sides = list(schema.SIDES)
    (root / CARD).write_text(_card(head, title, shards), encoding="utf-8")
    text = canonical_json(_croissant(root, head, title, sides))
    (root / CROISSANT).write_text(text, encoding="utf-8")


def _croissant(root: Path, head: dict[str, Any], title: str, sides: list[str]) -> dict[str, Any]:
    """Make the metadata: the shards as sets of files, the index as records."""
    index = {
        "@type": "cr:FileObject",
        "@id": schema.INDEX,
        "name": schema.INDEX,
        "contentUrl": schema.INDEX,
        "encodingFormat": "text/csv",
        "sha256": sha256(root / schema.INDEX),
    }
    sets = [
        {
            "@type": "cr:FileSet",
            "@id": side,
            "name": side,
            "encodingFormat": "application/x-hdf5",
            "includes": f"{side}/*.h5",
        }
        for side in sides
    ]
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"samples/{name}",
            "name": name,
            "description": _MEANINGS[name],
            "dataType": kind,
            "source": {"fileObject": {"@id": schema.INDEX}, "extract": {"column": name}},
        }
        for name, kind in _COLUMNS.items()
    ]
    records = {"@type": "cr:RecordSet", "@id": "samples", "name": "samples", "field": fields}
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": head["scene"],
        "description": f"{head['samples']} synthetic samples with known truth: {title}",
        "version": "2.0.0",
        "distribution": [index, *sets],
        "recordSet": [records],
    }


def _card(head: dict[str, Any], title: str, shards: Sequence[Shard]) -> str:
    """Write the data card."""
    counts: dict[str, int] = {}
    for shard in shards:
        counts[shard.split] = counts.get(shard.split, 0) + len(shard.numbers)
    frames, cameras, rows, columns = head["shape"]
    splits = "\n".join(f"| {name} | {count} |" for name, count in counts.items())
    truth = ", ".join(head["truth"]) or "seeds and drawn values"
    return "\n".join(
        [
            f"# {head['scene']}",
            f"\n{title}\n",
            "Synthetic images of particles with known truth, generated by sabench "
            f"{head['versions']['sabench']}: {head['samples']} independent samples of "
            f"{frames} frame(s) by {cameras} camera(s) of {rows} x {columns} pixels, 16 bit.\n",
            f"| split | samples |\n|---|---|\n{splits}\n",
            "A sample's split follows from a hash of its number; no sample is in two.\n",
            "- `observation/`: images and nominal cameras, what an experimenter has.",
            f"- `truth/`: what a solver that is judged must not see: {truth}.",
            f"- `{schema.INDEX}`: number, split, shard and row of every sample.",
            f"- `{schema.SCENE}`: the scene, which tells how the samples vary.",
            f"- `{schema.MANIFEST}`: sizes and SHA-256 of all files; `sabench verify` checks them.",
            "\nShards are HDF5 files, whose arrays `docs/formats/samples.md` of sabench describes. "
            'In Python, `sabench.open_samples(FOLDER, "train")` reads them.\n',
            f"Limits: renderings (renderer `{head['renderer']}`) of ideal particles through "
            "modelled optics and sensors, without dirt, vibration and faults of real recordings "
            "unless the scene has them.\n",
        ]
    )
