"""Standard output that never raises: a full device or a closed pipe must not end a run, nor hide how it ended."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import Any, TextIO


class GuardedOutput:
    """Wraps a text stream. After the first error of the system, which is kept in `error`, output is discarded.

    Characters that the stream's encoding does not have are written as escapes: names of files that are no text in it,
    or lines of a table where the encoding has letters only.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.error: OSError | None = None

    @classmethod
    def install(cls) -> GuardedOutput | None:
        """Put it in the place of `sys.stdout`; None when the process has no standard output."""
        if sys.stdout is None:
            return None
        guarded = cls(sys.stdout)
        sys.stdout = guarded
        return guarded

    def remove(self) -> None:
        """Give `sys.stdout` back."""
        sys.stdout = self._stream

    def write(self, text: str) -> int:
        """As of a text stream."""
        if self.error is None:
            try:
                return self._stream.write(text)
            except UnicodeEncodeError:
                return self._stream.write(_writable(text, self._stream.encoding))
            except OSError as error:
                self._give_up(error)
        return len(text)

    def flush(self) -> None:
        """As of a text stream."""
        if self.error is None:
            try:
                self._stream.flush()
            except OSError as error:
                self._give_up(error)

    def __getattr__(self, name: str) -> Any:
        """All else is the stream's own: encoding, isatty, fileno."""
        return getattr(self._stream, name)

    def _give_up(self, error: OSError) -> None:
        """What the stream still holds in its buffer goes nowhere, or the interpreter would fail on it at its end."""
        self.error = error
        with suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


def _writable(text: str, encoding: str) -> str:
    return text.encode(encoding, "backslashreplace").decode(encoding)
