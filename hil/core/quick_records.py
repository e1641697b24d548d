"""Frozen records that are built at every control step: `quickly_built` makes their construction half as long.

The constructor of a frozen dataclass sets each field by `object.__setattr__`, since plain assignment is what being
frozen forbids. Here the new object is of a class with the same slots that is not frozen while its fields are assigned,
and of its own class when the constructor returns. Nobody else sees it before.
Why: docs/decisions/0055-quick-records.md.
"""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import Any, TypeVar

Record = TypeVar("Record")


def quickly_built(record: type[Record]) -> type[Record]:
    """Replace the constructor of a frozen dataclass with slots; same arguments, same result.

    Raises TypeError for a class that is no such dataclass, that derives from a record, or does more when it is built.
    """
    parameters: Any = getattr(record, "__dataclass_params__", None)
    is_plain = parameters is not None and parameters.frozen and record.__bases__ == (object,)
    if not is_plain or "__slots__" not in vars(record) or hasattr(record, "__post_init__"):
        raise TypeError(f"{record.__name__} is not a plain frozen dataclass with slots")
    every: Any = fields(record)  # type: ignore[arg-type]
    names = tuple(field.name for field in every)
    # the names of the fields are arguments; those that begin with an underscore are free
    known: dict[str, Any] = {
        "_record": record,
        "_open_record": type(record.__name__, (), {"__slots__": names}),
        "_set": object.__setattr__,
        "_missing": MISSING,
    }
    arguments, assignments = [], []
    for field in every:
        name, value = field.name, field.name
        if field.default is not MISSING:
            known[f"_default_{name}"] = field.default
            arguments.append(f"{name}=_default_{name}")
        elif field.default_factory is not MISSING:
            known[f"_new_{name}"] = field.default_factory
            arguments.append(f"{name}=_missing")
            value = f"_new_{name}() if {name} is _missing else {name}"
        else:
            arguments.append(name)
        assignments.append(f"    self.{name} = {value}\n")
    source = (
        f"def __init__(self, {', '.join(arguments)}):\n"
        "    _set(self, '__class__', _open_record)\n"
        f"{''.join(assignments)}    self.__class__ = _record\n"
    )
    built: dict[str, Any] = {}
    exec(source, known, built)  # noqa: S102 - of names of fields alone, as dataclasses themselves do it
    constructor = built["__init__"]
    constructor.__qualname__ = f"{record.__qualname__}.__init__"
    constructor.__annotations__ = vars(record)["__init__"].__annotations__
    record.__init__ = constructor  # type: ignore[method-assign]
    return record
