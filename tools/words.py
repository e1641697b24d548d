"""`python -m tools.words`: finds the words that this project has retired; words.toml lists them with their plain ones.

    python -m tools.words                 # every tracked text file
    python -m tools.words README.md docs  # some of them

Exit code 0 when none is left, 1 when one was found (one line each: file, line, the word, what to write), 2 when git
can't list the files.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_name("words.toml")
SUFFIXES = frozenset({".py", ".md", ".toml", ".dbc", ".sh", ".yml", ".yaml", ".cff", ".ipynb", ".css", ".html"})
NAMES = frozenset({"Makefile"})
EXEMPT = frozenset({LIST, ROOT / "tests/tools/test_words_tool.py"})
LINE_START = re.compile(r"\n[ \t]*(?:#+|>)?[ \t]*")


@dataclass(frozen=True)
class Word:
    """A retired word: what finds it, and the plain one to use instead."""

    pattern: re.Pattern[str]
    use: str
    example: str
    is_exact: bool


@dataclass(frozen=True)
class Finding:
    """A retired word in a text: its line, counted from 1, the text as found, and what to write."""

    line: int
    found: str
    use: str


def load(file: Path = LIST) -> tuple[Word, ...]:
    """The list of retired words. Raises OSError, tomllib.TOMLDecodeError, KeyError or re.error for a bad list."""
    return tuple(_word(entry) for entry in tomllib.loads(file.read_text(encoding="utf-8"))["word"])


def find(text: str, words: Sequence[Word]) -> list[Finding]:
    """Every retired word of a text, in the order of the list."""
    plain = LINE_START.sub(lambda match: " " * len(match.group()), text).replace("_", " ")
    return [
        Finding(text.count("\n", 0, match.start()) + 1, " ".join(text[match.start() : match.end()].split()), word.use)
        for word in words
        for match in word.pattern.finditer(text if word.is_exact else plain)
    ]


def _word(entry: dict[str, Any]) -> Word:
    is_exact = bool(entry.get("exact", False))
    pattern = rf"(?<!\w)(?:{entry['pattern']})(?!\w)".replace(" ", r"\s+")
    return Word(re.compile(pattern, 0 if is_exact else re.IGNORECASE), entry["use"], entry["example"], is_exact)


def tracked(paths: Sequence[str] = ()) -> Iterator[Path]:
    """The text files that git tracks, but for the list itself and its test. Raises subprocess.CalledProcessError."""
    listed = subprocess.run(["git", "ls-files", "-z", "--", *paths], cwd=ROOT, check=True, stdout=subprocess.PIPE)
    for name in listed.stdout.decode().split("\0"):
        file = ROOT / name
        if (file.suffix in SUFFIXES or file.name in NAMES) and file not in EXEMPT and file.is_file():
            yield file


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what is found and return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.words", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("paths", nargs="*", help="files and folders; default: all that git tracks")
    words = load()
    try:
        files = list(tracked(parser.parse_args(arguments).paths))
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"words: git can't list the files: {error}", file=sys.stderr)
        return 2
    count = 0
    for file in files:
        for finding in sorted(find(file.read_text(encoding="utf-8"), words), key=lambda one: one.line):
            print(f"{file.relative_to(ROOT)}:{finding.line}: {finding.found!r} -> {finding.use}")
            count += 1
    print(f"{count} retired words in {len(files)} files")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
