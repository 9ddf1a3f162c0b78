"""Runs of the code blocks of a page, in their order, in one folder and in this process."""

import contextlib
import io
import json
import re
import runpy
import shlex
import shutil
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tomli_w

import sabench
from sabench.apps.own_calibration.folder import Configuration
from sabench.evaluation.suite_loading import load_suite, read_secret
from sabench.evaluation.suites import Suite
from sabench.scenes import scene_schema
from tests.docs.pages import ROOT, Block


class Page:
    def __init__(self, folder: Path, cache: Path, setenv: Callable[[str, str], None]) -> None:
        """Run in `folder`, which is the current one, and share data sets in `cache`."""
        self.folder, self.cache, self.setenv = folder, cache, setenv
        self.names: dict[str, Any] = {"__name__": "page"}
        self.output = ""

    def run(self, block: Block) -> None:
        if block.file is not None:
            self._save(block.file, block.text)
        elif block.language != "text":
            run = getattr(self, f"_run_{block.language}", None)
            assert run is not None, f"{block}: no way to check the language {block.language!r}"
            run(block)

    def _save(self, name: str, text: str) -> None:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")

    def _run_sh(self, block: Block) -> None:
        lines = block.text.replace("\\\n", " ").splitlines()
        self.output = "".join(self.command(line) for line in lines)

    def _run_python(self, block: Block) -> None:
        code = compile("\n" * block.line + block.text, str(ROOT / block.page), "exec")
        with contextlib.redirect_stdout(io.StringIO()) as out:
            exec(code, self.names)
        self.output = out.getvalue()

    def _run_output(self, block: Block) -> None:
        pattern = re.escape(block.text.strip()).replace(re.escape("..."), ".*")
        shown = "\n".join(line.rstrip() for line in self.output.strip().splitlines())
        assert re.fullmatch(pattern, shown, re.DOTALL), f"{block} shows another output:\n{shown}"

    def _run_json(self, block: Block) -> None:
        json.loads(block.text)

    def _run_toml(self, block: Block) -> None:
        """Check a scene, a suite or a calibration file, or a part of one."""
        values = tomllib.loads(block.text)
        if "target_mm" in values:
            Configuration.model_validate(values)
        elif "secret" in values:
            read_secret(self._written(block.text))
        elif values.keys() <= scene_schema()["properties"].keys():
            sabench.load_scene(self._completed("scenes/quick.toml", values))
        elif values.keys() <= Suite.model_fields.keys():
            load_suite(self._completed("scenes/suites/quick.toml", values))
        else:
            raise AssertionError(f"{block}: neither a scene nor a suite: {', '.join(values)}")

    def _completed(self, name: str, values: dict[str, Any]) -> Path:
        whole = tomllib.loads((ROOT / name).read_text(encoding="utf-8"))
        for key, value in values.items():
            old = whole.get(key)
            keep = isinstance(old, dict) and isinstance(value, dict) and "generator" not in value
            whole[key] = old | value if keep else value
        return self._written(tomli_w.dumps(whole))

    def _written(self, text: str) -> Path:
        path = self.folder / "block.toml"
        path.write_text(text, encoding="utf-8")
        return path

    def command(self, line: str) -> str:
        words = shlex.split(line, comments=True)
        target = None
        if ">" in words:
            words, target = words[: words.index(">")], words[-1]
        if not words:
            return ""
        if words[0] == "export":
            self.setenv(*words[1].split("=", 1))
            return ""
        text = self._call(words)
        if target is None:
            return text
        self._save(target, text)
        return ""

    def _call(self, words: list[str]) -> str:
        name, *rest = words
        if name == "sabench" and rest[:1] == ["generate"]:
            return self._generate(rest)
        if name == "sabench":
            return _printed(lambda: runpy.run_module("sabench", run_name="__main__"), words)
        if name == "python":
            return _printed(lambda: runpy.run_path(rest[0], run_name="__main__"), rest)
        raise AssertionError(f"{name}: a block with this command needs a marker `not run`")

    def _generate(self, words: list[str]) -> str:
        at = words.index("-o")
        out = self.folder / words[at + 1]
        key = "_".join([*words[:at], *words[at + 2 :]]).replace("/", "-")
        kept = self.cache / key
        if "--frames" in words or not kept.exists():
            text = _printed(
                lambda: runpy.run_module("sabench", run_name="__main__"), ["sabench", *words]
            )
            (self.cache / f"{key}.txt").write_text(text, encoding="utf-8")
            shutil.copytree(out, kept, dirs_exist_ok=True)
            return text
        shutil.copytree(kept, out)
        return (self.cache / f"{key}.txt").read_text(encoding="utf-8")


def _printed(call: Callable[[], object], words: list[str]) -> str:
    before, errors, code = sys.argv, io.StringIO(), None
    sys.argv = list(words)
    try:
        with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(errors):
            call()
    except SystemExit as end:
        code = end.code
    finally:
        sys.argv = before
    assert not code, f"{shlex.join(words)}: exit code {code}\n{errors.getvalue()}"
    return out.getvalue()
