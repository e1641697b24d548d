"""The public face: what `import hil` promises, and what it costs."""

import doctest
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import hil
import hil.bench.api
import hil.data.open_run


def test_all_is_the_documented_surface() -> None:
    """The list in the package's docstring and `__all__` are the same names."""
    table = hil.__doc__.split("\n\n")[2]
    listed = set()
    for line in table.splitlines():
        names = re.split(r"\s{2,}", line.strip())[0]
        listed |= {name.strip() for name in names.split(",")}
    assert listed == {*hil.__all__, "__version__"}


def test_every_public_name_is_there_and_documented() -> None:
    for name in hil.__all__:
        assert getattr(hil, name).__doc__, name
    assert set(dir(hil)) == {*hil.__all__, "__version__"}


def test_type_checkers_see_the_names_that_are_imported_lazily() -> None:
    """Every name of the lazy table is also in the `TYPE_CHECKING` block, from the same module."""
    source = Path(hil.__file__).read_text(encoding="utf-8")
    block = source.split("if TYPE_CHECKING:")[1].split("__all__")[0]
    seen: dict[str, str] = {}
    for module, names in re.findall(r"from (hil[\w.]*) import ([^\n]+)", block):
        seen |= {name.strip(): module for name in names.split(",")}
    assert seen == hil._MODULE_OF
    assert set(seen) == set(hil.__all__)


def test_a_name_that_is_not_public_is_refused_by_name() -> None:
    with pytest.raises(AttributeError, match=r"'hil' has no attribute 'simulation'.*hil\.__all__"):
        hil.simulation  # noqa: B018 - the access is the test


@pytest.mark.parametrize("name", ["load", "simulate", "run", "campaign", "design", "open_run", "runs"])
def test_functions_document_arguments_errors_and_an_example(name: str) -> None:
    doc = getattr(hil, name).__doc__
    for section in ("Parameters", "Returns", "Raises", "Examples"):
        assert re.search(rf"^\s+{section}\n\s+-+$", doc, re.MULTILINE), section
    arguments = getattr(hil, name).__code__.co_varnames[: getattr(hil, name).__code__.co_argcount]
    assert all(re.search(rf"\b{argument}\b", doc) for argument in arguments)


def test_the_examples_of_the_functions_give_what_they_show() -> None:
    """The example of `simulate` used to show a number of steps without those of the final ramp."""
    for module, examples in ((hil.bench.api, 10), (hil.data.open_run, 4)):
        failed, attempted = doctest.testmod(module)
        assert (failed, attempted >= examples) == (0, True)


def test_all_errors_have_one_base_class() -> None:
    for name in hil.__all__:
        if name.endswith("Error"):
            assert issubclass(getattr(hil, name), hil.HilError)


def test_import_hil_loads_neither_numpy_nor_can() -> None:
    """`hil --version` and the recorder's process start without them."""
    heavy = "{'numpy', 'can', 'scipy', 'pydantic', 'numba', 'typer', 'pandas'}"
    code = f"import sys, hil; print(sorted(set(sys.modules) & {heavy}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout.replace("'", '"')) == []


def test_a_run_loads_no_library_that_it_does_not_use() -> None:
    """Each `hil run` and `hil simulate` waited 1.5 s for python-control, scipy.signal, numba and matplotlib.

    With asammdf installed python-can loaded it, and pandas and polars with their threads.
    """
    scipy = "'scipy.signal', 'scipy.stats', 'scipy.optimize'"
    heavy = f"{{{scipy}, 'control', 'numba', 'matplotlib', 'rerun', 'pyarrow', 'pandas', 'polars', 'asammdf'}}"
    for modules in ("hil.bench.live_run, hil.bench.lockstep_run", "firmware_sim.cli, firmware_sim.serve"):
        code = f"import sys, {modules}; print(sorted(set(sys.modules) & {heavy}))"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert done.stdout == "[]\n"


@pytest.mark.long
def test_who_imports_asammdf_gets_it() -> None:
    code = "import sys, hil, can, asammdf; print(asammdf.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "asammdf\n"
