"""A table of things that a settings file chooses by name: built-in rows, and those of installed packages.

An installed package adds a row by an entry point of the table's group; its name is the row's, its value the maker:

    [project.entry-points."fourtank_hil.designs"]
    lqr = "my_package:make_design"

The settings check, the help, `hil design` and the error messages all read the table. A built-in name always means the
built-in row. Reasons: docs/decisions/0018-tables-and-entry-points.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar, cast

from hil.edge.config.settings_file import SettingsError

Maker = TypeVar("Maker", bound=Callable[..., Any])


@dataclass(frozen=True)
class TableChoice(Generic[Maker]):
    """A row. summary : one line for people. make : what builds it. package : "" for a built-in row."""

    name: str
    summary: str
    make: Maker
    package: str = ""


class ChoiceTable(Generic[Maker]):
    """key : the settings key that chooses, for messages. group : the entry points' group. rows : the built-in ones."""

    def __init__(self, key: str, group: str, *rows: TableChoice[Maker]) -> None:
        self.key = key
        self.group = group
        self._rows = {row.name: row for row in rows}

    @property
    def names(self) -> tuple[str, ...]:
        """All names: the built-in ones in the table's order, then those of installed packages."""
        return (*self._rows, *(name for name in installed(self.group) if name not in self._rows))

    def find(self, name: str, where: str) -> TableChoice[Maker]:
        """The row of that name. Raises SettingsError, `where` first, if there is none or its package does not load."""
        if name in self._rows:
            return self._rows[name]
        entry = installed(self.group).get(name)
        if entry is None:
            raise SettingsError(f"{where}: {self.key} = {name!r}: must be one of {', '.join(self.names)}")
        package = entry.dist.name if entry.dist is not None else entry.value
        try:
            make = cast("Maker", entry.load())
        except Exception as error:  # noqa: BLE001 - whatever a foreign package raises while it is imported
            raise SettingsError(
                f"{where}: {self.key} = {name!r}: package {package}, {entry.value}: {type(error).__name__}: {error}"
            ) from None
        return TableChoice(name, f"from the package {package}", make, package)


@cache
def installed(group: str) -> dict[str, EntryPoint]:
    """The installed entry points of a group by name, read once."""
    return {entry.name: entry for entry in sorted(entry_points(group=group), key=lambda entry: entry.name)}
