"""Page of the public interface: one entry for each name of `hil.__all__`; mkdocstrings fills in the docstrings."""

from __future__ import annotations

import inspect

import hil

ABOUT = """# API

`import hil` is the public interface. A name that is not on this page may change or move at any time.
"""


def api_page() -> str:
    """The whole page: functions first, then classes, then errors, each in the order of `hil.__all__`."""
    functions: list[str] = []
    classes: list[str] = []
    errors: list[str] = []
    for name in getattr(hil, "__all__", ()):
        value = getattr(hil, name)
        if inspect.isclass(value):
            (errors if issubclass(value, BaseException) else classes).append(name)
        elif callable(value):
            functions.append(name)
    groups = (("Functions", functions), ("Classes", classes), ("Errors", errors))
    return ABOUT + "".join(
        f"\n## {title}\n\n" + "".join(f"::: hil.{name}\n" for name in names) for title, names in groups if names
    )
