"""Ways to start the command beside its console script."""

import subprocess
import sys
from pathlib import Path

import pytest

import hil
from hil.cli import app


def test_python_dash_m_hil_is_the_command(tmp_path: Path) -> None:
    """`python -m hil` used to fail: the package had no `__main__`."""
    done = subprocess.run(
        [sys.executable, "-m", "hil", "--version"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == f"hil {hil.__version__}\n"


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("hil ct", ["ctl"]),
        ("hil ctl re", ["reference", "resume"]),
        ("hil run pump_l", ["pump_loss"]),
        ("hil simulate paper_g", ["paper_glr"]),
    ],
)
def test_the_shell_completes(
    words: str, offered: list[str], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """As the script of `hil --show-completion bash` asks for it."""
    monkeypatch.setenv("_HIL_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    with pytest.raises(SystemExit):
        app.app(prog_name="hil")
    assert capfd.readouterr().out.split() == offered
