"""What the comments of a TOML file say about each key."""

from __future__ import annotations

import re
from pathlib import Path

_HEADER = re.compile(r"^(\[\[?)([A-Za-z0-9_.]+)\]\]?\s*(?:#(.*))?$")
_KEY = re.compile(r"^(?:# )?([A-Za-z0-9_]+)\s*=\s*(.*)$")
_COMMENT = re.compile(r'^(?:"[^"]*"|[^"#])*#\s*(.*)$')


def comments_of(file: Path) -> dict[str, str]:
    """Comment behind each key and table, by path. A line of spaces and a comment continues the last."""
    found: dict[str, str] = {}
    lists: set[str] = set()
    prefix = last = ""
    for line in file.read_text(encoding="utf-8").splitlines():
        if header := _HEADER.match(line):
            name = header[2]
            if header[1] == "[[":
                lists.add(name)
            parts = name.split(".")
            marked = [part + ("[]" if ".".join(parts[: i + 1]) in lists else "") for i, part in enumerate(parts)]
            prefix, last = ".".join(marked) + ".", ".".join(marked)
            found[last] = (header[3] or "").strip()
        elif key := _KEY.match(line):
            last = prefix + key[1]
            comment = _COMMENT.match(key[2])
            found[last] = comment[1] if comment else found.get(last, "")
        elif last and (more := re.match(r"^\s+#\s*(.*)$", line)):
            found[last] += " " + more[1]
        else:
            last = ""
    return found
