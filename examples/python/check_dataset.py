#!/usr/bin/env python3
"""Check the hashes of a data set without sabench: check_dataset.py DATASET.

Print its content hash if every file is listed and intact, and fail otherwise.
"""

import hashlib
import json
import sys
from pathlib import Path


def canonical(value):
    """Write canonical JSON, as docs/formats/dataset.md defines it."""
    return json.dumps(value, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def digest(data):
    """Return the SHA-256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def main(dataset):
    """Compare the files of a data set with its manifest."""
    root = Path(dataset)
    text = (root / "manifest.json").read_bytes()
    manifest = json.loads(text)
    found = {
        path.relative_to(root).as_posix()
        for path in root.rglob("*")
        if path.is_symlink() or not path.is_dir()
    }
    assert found == {"manifest.json", *manifest["files"]}
    for name, entry in manifest["files"].items():
        data = (root / name).read_bytes()
        assert (len(data), digest(data)) == (entry["bytes"], entry["sha256"]), name
    hashes = {name: entry["sha256"] for name, entry in manifest["files"].items()}
    rest = {key: value for key, value in manifest.items() if key != "manifest_hash"}
    assert manifest["content_hash"] == digest(canonical(hashes).encode("utf-8"))
    assert manifest["manifest_hash"] == digest(canonical(rest).encode("utf-8"))
    assert text == canonical(manifest).encode("utf-8")
    print(manifest["content_hash"])


if __name__ == "__main__":
    main(*sys.argv[1:])
