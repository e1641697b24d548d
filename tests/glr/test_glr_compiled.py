"""The cache of compiled functions: valid for the sources that were compiled, wherever they stand."""

import inspect
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from hil.core.diagnosis.glr import glr_detector  # noqa: F401 - a digest is that of imported modules
from hil.core.diagnosis.glr.compiled import source_digest

ROOT = Path(__file__).parents[2]

HELPER = """
from hil.core.diagnosis.glr.compiled import compiled

FACTOR = {factor}

@compiled
def scaled(value):
    return {sign}FACTOR * value
"""

KERNEL = """
from toy.helper import scaled
from hil.core.diagnosis.glr.compiled import compiled

@compiled
def kernel(value):
    return scaled(value) + 1.0
"""

CALL = "from toy.kernel import kernel; print(kernel(10.0), sum(kernel.stats.cache_hits.values()))"


TYPED = """
from typing import NamedTuple

from hil.core.diagnosis.glr.compiled import compiled

class {name}(NamedTuple):
    value: float

@compiled
def kernel(given):
    return given.value + 1.0
"""


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    """A package of two modules: a compiled function, and the helper that is compiled into it."""
    package = tmp_path / "toy"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "kernel.py").write_text(KERNEL)
    (package / "helper.py").write_text(HELPER.format(factor=2.0, sign=""))
    return package


def python(*arguments: str, path: Path) -> str:
    environment = {"PYTHONPATH": f"{path}:{ROOT}", "PATH": "/usr/bin:/bin", "HOME": str(path)}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, env=environment, cwd=path, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def cache_files(package: Path) -> set[str]:
    return {file.name for file in (package / "__pycache__").glob("*.nb[ci]")}


@pytest.mark.long
def test_a_change_of_a_helper_in_another_file_is_seen_and_nothing_outdated_remains(toy: Path) -> None:
    """numba looks at the file of the function alone: the old helper stayed in force until the cache was deleted.

    And a file for every line that a function had ever stood on used to remain.
    """
    assert python("-c", CALL, path=toy.parent) == "21.0 0"
    assert python("-c", CALL, path=toy.parent) == "21.0 1"
    files = cache_files(toy)
    assert len(files) == 4  # index and code of two functions
    for factor, sign, expected in ((2.0, "-", "-19.0 0"), (3.0, "-", "-29.0 0")):
        (toy / "helper.py").write_text("\n" * round(factor) + HELPER.format(factor=factor, sign=sign))
        assert python("-c", CALL, path=toy.parent) == expected
    assert cache_files(toy) == files


@pytest.mark.long
def test_a_change_that_is_not_compiled_in_keeps_the_cache(toy: Path) -> None:
    (toy / "other.py").write_text("NUMBER = 1\n")
    python("-c", CALL, path=toy.parent)
    (toy / "other.py").write_text("NUMBER = 2\n")
    assert python("-c", f"import toy.other; {CALL}", path=toy.parent) == "21.0 1"


@pytest.mark.long
def test_a_read_only_installation_uses_the_folder_of_the_user_or_none(toy: Path) -> None:
    (toy / "__pycache__").write_text("")  # a file: no folder can be made there, whoever asks
    assert python("-c", CALL, path=toy.parent) == "21.0 0"
    assert python("-c", CALL, path=toy.parent) == "21.0 1"
    shutil.rmtree(toy.parent / ".cache")
    (toy.parent / ".cache").write_text("")
    assert python("-c", CALL, path=toy.parent) == "21.0 0"


MATCH = """
import numpy as np
from hil.core.diagnosis.glr import bank
count = bank.H * bank.SLOTS
energy, match, cross = np.zeros(count), np.zeros(count), np.zeros(bank.SLOTS)
bank._accumulate(np.eye(4), np.ones(4), np.ones((4, count)), energy, match, cross)
print(match[0])
"""


@pytest.mark.long
def test_a_change_of_the_filter_reaches_the_bank_that_it_is_compiled_into(tmp_path: Path) -> None:
    """The same with the diagnosis itself: `whitened` of filter.py is compiled into the functions of bank.py."""
    shutil.copytree(ROOT / "hil", tmp_path / "hil", ignore=shutil.ignore_patterns("__pycache__"))
    assert python("-c", MATCH, path=tmp_path) == "4.0"
    file = tmp_path / "hil/core/diagnosis/glr/filter.py"
    line = "value += whitener[i, j] * innovation[j]"
    assert line in file.read_text()
    file.write_text(file.read_text().replace(line, f"{line} * 2.0"))
    assert python("-c", MATCH, path=tmp_path) == "8.0"


@pytest.mark.parametrize(
    ("file", "changed"),
    [
        ("model", {"model", "filter", "bank", "refilter"}),
        ("hypotheses", {"bank", "refilter"}),
        ("filter", {"filter", "bank", "refilter"}),
        ("refilter", {"refilter"}),
        ("compiled", {"model", "filter", "bank", "refilter"}),
        ("declaration", set()),
    ],
)
def test_the_digest_of_a_module_follows_all_that_it_imports_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch, file: str, changed: set[str]
) -> None:
    """A change that is compiled in nowhere doesn't cost a quarter of a minute."""
    package = "hil.core.diagnosis.glr"
    names = ["model", "filter", "bank", "refilter"]
    before = [source_digest(f"{package}.{name}") for name in names]
    source_of = inspect.getsource

    def edited(module: ModuleType) -> str:
        return source_of(module) + ("ADDED = 1\n" if module.__name__ == f"{package}.{file}" else "")

    monkeypatch.setattr(inspect, "getsource", edited)
    after = [source_digest(f"{package}.{name}") for name in names]
    assert {name for name, old, new in zip(names, before, after, strict=True) if old != new} == changed


@pytest.mark.long
def test_a_cache_that_names_a_class_of_before_is_compiled_again(toy: Path) -> None:
    """numba reads the types of the arguments before the digest: a class with a new name ended every process."""
    for name in ("Before", "After"):
        (toy / "kernel.py").write_text(TYPED.format(name=name))
        call = f"from toy.kernel import {name}, kernel; print(kernel({name}(1.0)))"
        assert python("-c", call, path=toy.parent) == "2.0"
