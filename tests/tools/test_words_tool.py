"""The word check: it finds each retired word wherever it is written, and names file, line and the plain word."""

import subprocess
from pathlib import Path

import pytest

from tools import words

RETIRED = words.load()


@pytest.mark.parametrize("word", RETIRED, ids=lambda word: word.example)
def test_each_retired_word_is_found_in_its_example(word: words.Word) -> None:
    assert words.find(f"A line.\n# And so: {word.example}, every time.\n", [word])


@pytest.mark.parametrize("word", RETIRED, ids=lambda word: word.example)
def test_the_plain_word_is_not_itself_retired(word: words.Word) -> None:
    assert words.find(word.use, RETIRED) == []


@pytest.mark.parametrize(
    "text",
    ["wish", "Wishes", "WISH", "an operator_wish = 1", "_wish", "# wish"],
    ids=["word", "plural", "capitals", "part of a name", "private name", "comment"],
)
def test_a_word_is_found_in_prose_and_in_names(text: str) -> None:
    assert [finding.use for finding in words.find(text, RETIRED)] == ["request"]


@pytest.mark.parametrize("text", ["soundness", "amends", "storyboard", "MOSTLY_FLAT", "ALMOST_DRY", "The most_rows"])
def test_a_longer_word_that_contains_a_retired_one_is_allowed(text: str) -> None:
    assert words.find(text, RETIRED) == []


@pytest.mark.parametrize("between", [" ", "\n", "\n    ", "\n# ", "\n    # "])
def test_a_phrase_is_found_across_a_line_break_and_its_first_line_is_named(between: str) -> None:
    text = f"one\ntwo second{between}thoughts\n"
    assert [(finding.line, finding.use) for finding in words.find(text, RETIRED)] == [(2, "drift review")]


def test_the_command_names_file_line_and_plain_word_and_exits_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    (tmp_path / "notes.md").write_text("Plain.\nA stranger sends.\n")
    (tmp_path / "picture.png").write_bytes(b"\xff stranger")
    subprocess.run(["git", "-C", tmp_path, "add", "."], check=True)
    monkeypatch.setattr(words, "ROOT", tmp_path)
    assert words.main([]) == 1
    assert capsys.readouterr().out == (
        "notes.md:2: 'stranger' -> unknown sender, foreign frame\n1 retired words in 1 files\n"
    )
    (tmp_path / "notes.md").write_text("Plain.\n")
    assert words.main([]) == 0


def test_without_git_the_command_says_so_and_exits_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(words, "ROOT", tmp_path)
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "none"))
    assert words.main([]) == 2
    assert "git can't list the files" in capsys.readouterr().err
