"""Scoring program of a challenge server: python score.py INPUT OUTPUT.

INPUT holds the reference data in `ref` and the submission in `res`; the scores go to OUTPUT.
"""

import sys
from pathlib import Path

from sabench.apps.challenge.scoring import score_submission
from sabench.utils.errors import InputError


def main(source: str, target: str) -> int:
    """Score the submission; return the exit code."""
    try:
        means = score_submission(Path(source) / "ref", Path(source) / "res", Path(target))
    except InputError as error:
        print(f"score: {error}", file=sys.stderr)
        return 1
    print("\n".join(f"{key}: {value!r}" for key, value in means.items()))
    return 0


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("score: expected two folders: python score.py INPUT OUTPUT")
    sys.exit(main(sys.argv[1], sys.argv[2]))
