"""The command line: lists, help, completion and messages."""

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sabench.cli import main as command_line
from sabench.utils.errors import InputError
from tests.conftest import ROOT, Command
from tests.helpers.commands import refuse, run_python, succeed
from tests.helpers.refusals import check_sentence

GONE = '"""Gone."""\n\nfrom sabench.reproject import sweep\n'
registered = command_line.app.registered_commands.copy


def on_a_terminal(*words: str, columns: int = 80) -> list[str]:
    outside, inside = pty.openpty()
    environment = {key: os.environ[key] for key in ("PATH", "HOME") if key in os.environ}
    environment |= {"COLUMNS": str(columns), "PYTHONPATH": str(ROOT), "TERM": "dumb"}
    child = subprocess.Popen(
        [sys.executable, "-m", "sabench", *words], stdout=inside, stderr=inside, env=environment
    )
    os.close(inside)
    text = b""
    while True:
        try:
            block = os.read(outside, 65536)
        except OSError:  # on Linux, the end of what a closed terminal holds
            break
        if not block:
            break
        text += block
    os.close(outside)
    assert child.wait() == 0
    return text.decode().replace("\r", "").splitlines()


def test_a_list_on_a_terminal_fits_it() -> None:
    lines = on_a_terminal("list")
    assert max(map(len, lines)) <= 80
    assert any("solvers: velocimetry" in line for line in lines)
    assert any(line.startswith("  refractive_autocal_randomised  ") for line in lines)


def test_a_piped_list_has_one_whole_line_for_each_entry(command: Command) -> None:
    done = succeed(command("list"))
    (msa,) = (line for line in done.stdout.splitlines() if " msa " in line)
    assert msa.split()[:3] == ["solver", "msa", "reconstruction"]
    assert msa.endswith(".")
    kinds = {line.split()[0] for line in done.stdout.splitlines()}
    assert kinds == {"generator", "solver", "scene", "suite"}


def test_a_list_can_be_filtered(command: Command) -> None:
    found = json.loads(command("list", "--task", "velocimetry", "--json").stdout)
    assert [one["name"] for one in found] == ["piv2d", "piv3d", "piv3d_plain"]
    assert {one["task"] for one in found} == {"velocimetry"}
    suites = json.loads(command("list", "--kind", "suite", "--json").stdout)
    assert {one["kind"] for one in suites} == {"suite"}
    refuse(command("list", "--task", "velocity"), "--task")
    refuse(command("list", "--kind", "solvers"), "--kind")


def test_a_broken_plug_in(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = command("list").stdout
    (tmp_path / "mine/solvers").mkdir(parents=True)
    (tmp_path / "mine/solvers/gone.py").write_text(GONE, encoding="utf-8")
    monkeypatch.setenv("SABENCH_PLUGINS", str(tmp_path / "mine"))
    done = command("list")
    assert done.returncode == 0
    assert done.stdout == whole
    (warning,) = done.stderr.splitlines()
    check_sentence(warning, "gone", "sabench.reproject")


def test_the_bare_command_prints_help_and_no_error(command: Command) -> None:
    done = command()
    assert done.returncode == 0
    assert done.stderr == ""
    assert "Usage:" in done.stdout
    assert "evaluate" not in done.stdout


@pytest.mark.slow
def test_help_shows_no_types_of_flags() -> None:
    commands = [info.name or info.callback.__name__ for info in registered() if info.callback]
    assert len(commands) == 29
    for name in commands:
        done = CliRunner().invoke(command_line.app, [name, "--help"])
        assert done.exit_code == 0
        assert "bool" not in done.output.lower()
        assert "range" not in done.output
        assert "--track" not in done.output


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("msa", ["solver msa (reconstruction)", "exponent", "> 0, <= 1", "Belden", "median Q"]),
        ("uniform", ["generator uniform (particles)", "per_pixel", "0.05"]),
        ("quick", ["scene quick", "4 cameras of 320 x 240 px", "suite quick", "Solvers: asa, msa"]),
        ("rms_mm", ["score rms_mm (particles)", "(it follows rms_px: root mean square distance"]),
        ("q", ["score q (reconstruction)", "the larger, the better, from -1 to 1"]),
    ],
)
def test_parts_are_described_by_their_names(name: str, told: list[str]) -> None:
    done = CliRunner().invoke(command_line.app, ["info", name])
    assert done.exit_code == 0, done.exception
    missing = [text for text in told if text not in done.output]
    assert not missing, done.output


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("info bayesan_ipr", "did you mean bayesian_ipr?"),
        ("generate msa -o d", "expected a scene, got msa, the name of a solver"),
        ("solve quick msa -o r.h5", "expected a solver, got quick, the name of a scene"),
        ("verify msa", "usage: main verify [OPTIONS] DATASET"),
        (f"generate {'a' * 300} -o d", "expected a file's name"),
    ],
)
def test_names_of_other_things_are_recognised(words: str, sentence: str) -> None:
    done = CliRunner().invoke(command_line.app, words.split(), prog_name="main")
    assert isinstance(done.exception, InputError)
    assert sentence in str(done.exception)


@pytest.mark.slow_but_first
@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("solve refractive_autocal_", "refractive_autocal_alternating"),
        ("generate qui", "quick"),
        ("run stand", "standard"),
        ("check c", "ci"),
        ("calibrate own --solver solo", "soloff"),
        ("score d r --task velo", "velocimetry"),
    ],
)
def test_shells_complete_names(command: Command, words: str, offered: str) -> None:
    environment = {
        "_SABENCH_COMPLETE": "complete_bash",
        "COMP_WORDS": f"sabench {words}",
        "COMP_CWORD": str(len(words.split())),
    }
    script = "from sabench.cli.main import app; app(prog_name='sabench')"
    done = run_python("-c", script, env=environment)
    assert offered in done.stdout.split(), done.stderr


def test_an_error_of_several_lines_is_printed_as_lines(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class SeveralError(InputError):
        def __str__(self) -> str:
            return "s.toml: 2 faults\na: expected   1, got 2\nb: missing"

    def fail(**_: object) -> None:
        raise SeveralError

    monkeypatch.setattr(command_line, "app", fail)
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    assert ended.value.code == 2
    expected = "sabench: s.toml: 2 faults\n  a: expected 1, got 2\n  b: missing\n"
    assert capsys.readouterr().err == expected
