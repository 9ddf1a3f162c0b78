"""Worth of each rule of a room: its score on a panel of small cases with the rule changed.

    python benchmarks/ablation.py images algorithms/particles [--rules TEXT ...] [--cases TEXT ...]
        [--seeds 101] [--jobs 1] [--record benchmarks/records/ablation.json]

A rule is a statement of numbers at the top of a module of the room: constants that act together
stand in one statement. It is halved and doubled (of shares above one half, what is missing to one
is). Rules that `ablation_rules.py` lists are switched off, too, and so are the branches that it
lists. Each variant runs in a new Python, whose importer changes that statement before numba sees
it, on the cases that enter a function which uses the rule; where a kernel does, that and its
callers are compiled anew. Variants run in turn until one matters; with one seed, a variant ends
with the first case that it makes worse, the fastest cases first.

A record holds, of each rule, variant, case and seed, the figures of the case, and of each code of
the room that rules were judged with, the figures without a change. A rule that was judged is
measured again when its own text has changed, or if it is named by `--rules`. The last column of the
table is the verdict: *keep* where a variant makes some case worse by more than `LOSS` of F1 and
a particle and a half, or by `WORSE_RMS`; *weigh* where another case gets better by as much; *turn*
where cases only get better; *go* where nothing matters, and *no case* where none uses the rule.
"""

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks.ablation_rules import Rule, change, rules_of  # noqa: E402
from sabench.utils.kernel_folder import kernel_folder  # noqa: E402

RECORD = Path(__file__).with_name("records") / "ablation.json"
LOSS, WORSE_RMS = 0.003, 1.1  # of F1, and of the RMS distance: what a rule must be worth


def run_here(room: str, cases: list[str], seeds: list[int], traced: bool) -> None:
    """Score cases in this Python, and print one line of JSON each."""
    import warnings

    from benchmarks.ablation_cases import run
    from sabench.utils.errors import InputError

    entered: set[str] = set()

    def trace(frame: FrameType, event: str, value: object) -> None:
        if event == "call" and (name := frame.f_globals.get("__name__", "")).startswith("sabench."):
            entered.add(f"{name.partition('.')[2]}.{frame.f_code.co_name}")

    for seed in seeds:
        for case in cases:
            entered.clear()
            if traced:
                threading.setprofile(trace)
                sys.setprofile(trace)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    figures: dict[str, Any] = dict(run(room, case, seed))
                except (InputError, ArithmeticError, ValueError, IndexError) as error:
                    figures = {"f1": 0.0, "error": f"{type(error).__name__}: {error}"[:200]}
            sys.setprofile(None)
            threading.setprofile(None)
            row = {"case": case, "seed": seed} | figures
            print(json.dumps(row | ({"entered": sorted(entered)} if traced else {})), flush=True)


def run_variant(
    room: str, rule: Rule | None, variant: str, cases: list[str], seed: int
) -> Iterator[dict[str, Any]]:
    """Score cases in a new Python, one after the other, with a rule changed.

    A case that does not come to its end has an F1 of 0. That Python ends with the iterator.
    """
    words = [sys.executable, str(Path(__file__)), room, "--cases", *cases, "--seeds", str(seed)]
    environment = os.environ | {"PYTHONWARNINGS": "ignore"}
    changed = [rule.module, rule.name, rule.variants[variant]] if rule else ["", "", ""]
    with tempfile.TemporaryDirectory() as folder:
        if rule is not None and rule.kernels:
            environment["NUMBA_CACHE_DIR"] = folder
            _copy_kernels(Path(folder), rule.kernels)
        with tempfile.TemporaryFile("w+") as errors:
            child = subprocess.Popen(
                [*words, "--change", *changed],
                env=environment,
                text=True,
                stdout=subprocess.PIPE,
                stderr=errors,
            )
            assert child.stdout is not None
            try:
                left = set(cases)
                for line in child.stdout:
                    if line.startswith("{"):
                        row = json.loads(line)
                        left.remove(row["case"])
                        yield row
                child.wait()
            finally:
                child.kill()
                child.wait()
            errors.seek(0)
            why = (errors.read().strip().splitlines()[-1:] or [f"exit {child.returncode}"])[0][:200]
    for case in sorted(left):
        yield {"case": case, "seed": seed, "f1": 0.0, "error": why}


def _copy_kernels(folder: Path, without: set[str]) -> None:
    """Copy the compiled kernels, but those with the names: these hold a constant's old value."""
    home = kernel_folder()
    for file in home.rglob("*.nb?"):
        # module.function-line.version.number.nbc; functions within others have dots before them
        name = file.name.split("-")[0].split(".")[-1]
        if name not in without:
            place = folder / home.name / file.relative_to(home)
            place.parent.mkdir(parents=True, exist_ok=True)
            os.link(file, place) if file.suffix == ".nbc" else shutil.copy(file, place)


def code_of(room: str) -> str:
    """Hash the room's code: figures of other code are not compared."""
    whole = hashlib.sha256()
    for path in sorted((ROOT / "sabench" / room).rglob("*.py")):
        whole.update(path.read_bytes())
    return whole.hexdigest()[:16]


def measure(options: argparse.Namespace, room: str, cases: list[str]) -> dict[str, Any]:
    """Measure what the record does not hold, and write it after each variant."""
    record = json.loads(options.record.read_text()) if options.record.exists() else {}
    own, code = record.setdefault(room, {"as it is": {}, "rules": {}}), code_of(room)
    chosen = [
        rule
        for rule in rules_of(room)
        if not options.rules or any(text in rule.key for text in options.rules)
    ]
    screened, table = len(options.seeds) == 1, own["rules"]
    for rule in chosen:
        old = table.get(rule.key, {})
        again = options.rules or not (screened and _judged(own, rule))
        if old.get("code") != code and again:
            table[rule.key] = {"text": rule.text, "code": code, "variants": {}}
    used = {entry["code"] for entry in table.values()} | {code}
    own["as it is"] = {of: rows for of, rows in own["as it is"].items() if of in used}
    panel = Panel(room, cases, options.seeds, own, own["as it is"].setdefault(code, []))
    panel.trace()
    lock = threading.Lock()

    def work(rule: Rule) -> None:
        """Run variants, until one matters."""
        for variant in rule.variants if table[rule.key]["code"] == code else ():
            if screened and _matters(own, rule.key):
                break
            panel.fill(rule, variant, table[rule.key]["variants"].setdefault(variant, []))
            print(f"{rule.key} {variant}: {_moved(own, rule.key, variant)}", flush=True)
            with lock:
                options.record.write_text(_written(record))

    options.record.write_text(_written(record))
    with ThreadPoolExecutor(options.jobs) as pool:
        list(pool.map(work, chosen))
    return record


def _matters(own: dict[str, Any], key: str) -> bool:
    return verdict(own, key) not in ("go", _OPEN)


def _judged(own: dict[str, Any], rule: Rule) -> bool:
    """Return whether a rule with this text was judged, with whatever code."""
    entry = own["rules"].get(rule.key)
    if entry is None or entry["text"] != rule.text:
        return False
    return _matters(own, rule.key) or entry["variants"].keys() >= rule.variants.keys()


@dataclass
class Panel:
    """Cases of a room, and what they show without and with a changed rule.

    Attributes
    ----------
    own : the room's record.
    base : its rows without a change, with the present code.
    """

    room: str
    cases: list[str]
    seeds: list[int]
    own: dict[str, Any]
    base: list[dict[str, Any]]

    def trace(self) -> None:
        """Run the cases without a change, and find the functions that each enters."""
        from benchmarks.ablation_cases import FOLDER

        self.entered = defaultdict[str, set[str]](set)
        # too many for the record
        names = FOLDER / f"entered-{code_of(self.room)}.json"
        if names.exists():
            known = json.loads(names.read_text())
            self.entered.update({case: set(functions) for case, functions in known.items()})
        else:
            self.base.clear()
        self.fill(None, "", self.base)
        found = {case: sorted(functions) for case, functions in self.entered.items()}
        names.write_text(json.dumps(found))

    def fill(self, rule: Rule | None, variant: str, rows: list[dict[str, Any]]) -> None:
        """Add the rows that are missing; with one seed, up to the first case that is worse."""
        seconds = {row["case"]: row.get("cpu_s", 0.0) for row in self.base}
        order = sorted(self.cases, key=lambda case: (seconds.get(case, 0.0), case))
        known, screened = {(row["case"], row["seed"]) for row in rows}, len(self.seeds) == 1
        for seed in self.seeds:
            todo = [
                case
                for case in order
                if (case, seed) not in known and (not rule or rule.users & self.entered[case])
            ]
            for row in run_variant(self.room, rule, variant, todo, seed) if todo else ():
                self.entered[row["case"]].update(row.pop("entered", ()))
                rows.append(_rounded(row))
                if rule and screened and worth(self.own, rule.key, variant)[row["case"]].worse:
                    break


def _rounded(row: dict[str, Any]) -> dict[str, Any]:
    """Leave out what is not compared."""
    shown = ("case", "seed", "f1", "rms_px", "true", "cpu_s", "error")
    return {
        key: round(row[key], 4) if isinstance(row[key], float) else row[key]
        for key in shown
        if key in row
    }


def _written(record: dict[str, Any]) -> str:
    """Write a record with a line for each rule."""
    rooms = []
    for room, own in sorted(record.items()):
        parts = [
            f"{json.dumps(part)}: {{\n"
            + ",\n".join(f"{json.dumps(key)}: {json.dumps(of[key])}" for key in sorted(of))
            + "}"
            for part, of in sorted(own.items())
        ]
        rooms.append(f"{json.dumps(room)}: {{" + ",\n".join(parts) + "}")
    return "{" + ",\n".join(rooms) + "}\n"


@dataclass(frozen=True)
class Worth:
    """Loss of a case by a variant, as means over the seeds.

    Attributes
    ----------
    lost : F1.
    rms : ratio of the RMS distances.
    least : F1 that counts: `LOSS`, or a particle and a half.
    """

    lost: float
    rms: float
    least: float

    @property
    def worse(self) -> bool:
        """Say whether the case is worse without the rule as it is."""
        return self.lost > self.least or (self.rms > WORSE_RMS and self.lost > -self.least)

    @property
    def better(self) -> bool:
        """Say whether the case is better without the rule as it is."""
        return self.lost < -self.least or (self.rms < 1.0 / WORSE_RMS and self.lost < self.least)


def worth(own: dict[str, Any], key: str, variant: str) -> dict[str, Worth]:
    """Compare a variant with the rule as it is, case by case, given a room's record."""
    entry = own["rules"][key]
    plain = {(row["case"], row["seed"]): row for row in own["as it is"][entry["code"]]}
    losses = defaultdict(list)
    for row in entry["variants"].get(variant, []):
        base = plain.get((row["case"], row["seed"]))
        if base:
            shown = "rms_px" in row and "rms_px" in base
            rms = row["rms_px"] / max(base["rms_px"], 1e-9) if shown else 1.0
            least = max(LOSS, 1.5 / base.get("true", 1e9))
            losses[row["case"]].append((base["f1"] - row["f1"], rms, least))
    return {
        case: Worth(*(sum(column) / len(column) for column in zip(*rows, strict=True)))
        for case, rows in losses.items()
    }


def _moved(own: dict[str, Any], key: str, variant: str) -> str:
    told = [
        f"{case} {-one.lost:+.3f}, rms x {one.rms:.2f}"
        for case, one in worth(own, key, variant).items()
        if one.worse or one.better
    ]
    return "; ".join(told) or "nothing"


def verdict(own: dict[str, Any], key: str) -> str:
    """Judge a rule: keep (some case is worse without), weigh (others better), turn, or go."""
    every = [
        one
        for variant in own["rules"].get(key, {"variants": {}})["variants"]
        for one in worth(own, key, variant).values()
    ]
    if not every:
        return _OPEN
    lost, gained = any(one.worse for one in every), any(one.better for one in every)
    return ("weigh" if gained else "keep") if lost else "turn" if gained else "go"


def table_of(record: dict[str, Any], room: str) -> str:
    """Write a Markdown table of the rules of a room that were measured, worth last."""
    lines = ["| rule | as it is | what a change moves | verdict |", "|---|---|---|---|"]
    own = record[room]
    keys = [key for key, entry in own["rules"].items() if entry["variants"]]
    for key in sorted(keys, key=lambda key: (_ORDER.index(verdict(own, key)), key)):
        entry = own["rules"][key]
        text = " ".join(entry["text"].partition("=")[2].split())
        told = "; ".join(f"{variant}: {_moved(own, key, variant)}" for variant in entry["variants"])
        short = key.removeprefix(f"{room.replace('/', '.')}.")
        as_it_is = f"`{text}`" if text else "a branch"
        lines.append(f"| `{short}` | {as_it_is} | {told} | {verdict(own, key)} |")
    return "\n".join(lines)


_OPEN = "no case"
_ORDER = ("go", "turn", "weigh", _OPEN, "keep")


def main() -> None:
    """Measure rules, or, as a child, one variant."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rooms", nargs="+", metavar="ROOM")
    parser.add_argument("--rules", nargs="+", default=[])
    parser.add_argument("--cases", nargs="+", default=[])
    parser.add_argument("--seeds", type=int, nargs="+", default=[101])
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--record", type=Path, default=RECORD)
    parser.add_argument("--table", action="store_true", help="print the record's table only")
    parser.add_argument("--change", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.change:
        if options.change[0]:
            change(*options.change)
        run_here(options.rooms[0], options.cases, options.seeds, not options.change[0])
        return
    from benchmarks.ablation_cases import CASES

    for room in options.rooms:
        cases = [c for c in CASES[room] if not options.cases or any(t in c for t in options.cases)]
        if options.table:
            print(table_of(json.loads(options.record.read_text()), room))
        else:
            print(table_of(measure(options, room, cases), room))


if __name__ == "__main__":
    main()
