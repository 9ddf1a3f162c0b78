"""Tables that fit the terminal."""

import pytest

from sabench.cli import tables

HEADINGS = ["case", "solver", *(f"score_{i}" for i in range(12))]


WIDTH = tables.width


def row(name: str) -> list[str]:
    return [name, "msa", *(f"{i}.{i}" for i in range(12))]


@pytest.fixture(autouse=True)
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "width", lambda: 80)


def test_one_wide_row_is_transposed(capsys: pytest.CaptureFixture[str]) -> None:
    tables.show(HEADINGS, [row("quick")])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    for heading, value in zip(HEADINGS, row("quick"), strict=True):
        assert any(heading in line and value in line for line in lines)


def test_wide_rows_are_split_and_parts_name_rows(capsys: pytest.CaptureFixture[str]) -> None:
    tables.show(HEADINGS, [row("one"), row("two")], keys=2)
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    parts = out.count("solver")
    assert parts > 1
    assert out.count("one") == out.count("two") == parts
    assert all(out.count(f"{heading} ") == 1 for heading in HEADINGS[2:])


def test_a_narrow_table_stays_one_with_brackets_as_they_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    tables.show(HEADINGS[:4], [row("one")[:4], row("[bold]x[/bold]")[:4]])
    out = capsys.readouterr().out
    assert out.count("case") == 1
    assert "[bold]x[/bold]" in out


def test_sentences_are_wrapped_and_numbers_are_not(capsys: pytest.CaptureFixture[str]) -> None:
    tables.show_wrapped(["row", "note"], [["fig-2-6", "many words " * 20]])
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    assert "fig-2-6" in out
    assert out.count("many") == out.count("words") == 20


def test_piped_output_is_wide() -> None:
    assert WIDTH() == tables.PIPED_WIDTH


@pytest.mark.parametrize(
    ("text", "columns", "cut"), [("abc", 3, "abc"), ("abcd", 3, "ab…"), ("a bcd", 3, "a…")]
)
def test_long_texts_end_in_an_ellipsis(text: str, columns: int, cut: str) -> None:
    assert tables.shorten(text, columns) == cut
