"""Bundle small pictures of the bundled records of suite `standard`.

    python benchmarks/small_pictures.py LEADERBOARD

Takes what `sabench run standard --leaderboard LEADERBOARD` drew of the results that are
in leaderboard/records/standard.jsonl, scales them down, and writes them as WebP to
leaderboard/records/pictures, in place of what is there. Others are passed over. Prints how many
there are, and their size. Where LEADERBOARD lacks the picture of a bundled record, nothing is
written.
"""

import argparse
import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2

from sabench.evaluation.leaderboard.board import stem_of

ROOT = Path(__file__).resolve().parents[1]
RECORDS = ROOT / "leaderboard" / "records"
_SCALE, _QUALITY = 0.6, 40  # of the pictures: all of them stay below 5 MB


def named(records: list[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yield the folders and stems of pictures of records without errors."""
    for record in records:
        if record["pictures"]:
            stem = stem_of(record)
            own = [] if record["error"] else [stem, f"{stem}.error", f"{stem}.left"]
            for one in ("images", "truth", *own):
                yield record["pictures"], one


def shrink(path: Path, out: Path) -> int:
    """Write a picture scaled down; returns its bytes."""
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise SystemExit(f"{path}: expected a picture")
    size = [round(_SCALE * length) for length in picture.shape[1::-1]]
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    out.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(out), small, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    return out.stat().st_size


def main() -> None:
    """Write the small pictures, and say what is missing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("leaderboard", type=Path)
    drawn = parser.parse_args().leaderboard / "pictures"
    lines = (RECORDS / "standard.jsonl").read_text(encoding="utf-8").splitlines()
    wanted = set(named([json.loads(line) for line in lines]))
    there = sorted(
        (folder, stem) for folder, stem in wanted if (drawn / folder / f"{stem}.png").is_file()
    )
    without = sorted({one for one in wanted if "." not in one[1]} - set(there))
    if without:
        sys.exit(
            f"{drawn}: expected pictures of all bundled records, {len(without)} are missing: "
            f"the first is {'/'.join(without[0])}.png"
        )
    out = RECORDS / "pictures"
    shutil.rmtree(out, ignore_errors=True)
    sizes = [
        shrink(drawn / folder / f"{stem}.png", out / folder / f"{stem}.webp")
        for folder, stem in there
    ]
    print(f"{len(sizes)} pictures of {sum(sizes) / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
