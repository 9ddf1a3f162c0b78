"""Tables, in Markdown, of the cost of each effect of suite `realism` to each solver.

    python benchmarks/realism.py [--records FOLDER ...] [--json FILE]

Reads the records of `sabench run suites/realism`. A cost is the score of a case less that of the
clean one of the same seed, mean over the seeds with half of the 95 % confidence interval (Student's
t). `--json` writes every score.
"""

import argparse
import json
import tomllib
from pathlib import Path

from sabench.evaluation.records import latest, read_records
from sabench.scenes.loading import find
from sabench.utils.confidence import mean_of

Scores = dict[tuple[str, str], dict[int, float]]  # (effect, solver): seed: score
_TABLES = (  # family of cases, score, its name
    ("volume", "q", "Q of volumes"),
    ("volume", "peak_f1", "F1 of the peaks of volumes"),
    ("particle", "f1", "F1 of particles"),
)
_CLEAN = "clean"


def read_scores(folders: list[Path], family: str, key: str) -> Scores:
    """Collect a score of all cases of a family."""
    found: Scores = {}
    for record in latest([one for folder in folders for one in read_records(folder)]):
        kind, _, effect = record["case"].partition("-")
        value = record.get(key)
        if record["suite"] == "realism" and kind == family and value is not None:
            found.setdefault((effect, record["solver"]), {})[record["seed"]] = value
    return found


def effects_of(family: str) -> list[str]:
    """List the cases of a family in the suite's order."""
    suite = tomllib.loads(find("realism", "scenes/suites").read_text(encoding="utf-8"))
    names = (case["name"].partition("-") for case in suite["cases"])
    return [effect for kind, _, effect in names if kind == family]


def cost(scores: Scores, effect: str, solver: str) -> str:
    """Format the clean score, or what an effect adds to it."""
    own, clean = scores.get((effect, solver), {}), scores.get((_CLEAN, solver), {})
    if effect == _CLEAN:
        values = list(own.values())
    else:
        values = [own[seed] - clean[seed] for seed in sorted(own.keys() & clean.keys())]
    mean = mean_of(values)
    if mean is None:
        return "-"
    sign = "" if effect == _CLEAN else "+" if mean.mean >= 0.0 else ""
    return sign + mean.text(3)


def table(scores: Scores, effects: list[str]) -> str:
    """Write a table: a row for each effect, a column for each solver, the best one first."""
    solvers = sorted({solver for _, solver in scores}, key=lambda one: -_clean(scores, one))
    head = ["effect", *(f"`{solver}`" for solver in solvers)]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for effect in effects:
        label = "clean: the score" if effect == _CLEAN else effect
        lines.append("| " + " | ".join([label, *(cost(scores, effect, one) for one in solvers)]))
        lines[-1] += " |"
    return "\n".join(lines)


def _clean(scores: Scores, solver: str) -> float:
    mean = mean_of(list(scores.get((_CLEAN, solver), {}).values()))
    return mean.mean if mean else 0.0


def main() -> None:
    """Print the tables; write all scores to a file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=Path, nargs="+", default=[Path("leaderboard/records")])
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    every = {}
    for family, key, shown in _TABLES:
        scores = read_scores(chosen.records, family, key)
        seeds = sorted({seed for own in scores.values() for seed in own})
        print(f"{shown}, seeds {', '.join(map(str, seeds))}:\n")
        print(table(scores, effects_of(family)) + "\n")
        every[f"{family}, {key}"] = {f"{e}, {s}": own for (e, s), own in scores.items()}
    if chosen.json:
        chosen.json.write_text(json.dumps(every, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
