"""The help of every command: an example that can be typed, one row of a table each, readable in a narrow terminal."""

import re
import shlex
from types import ModuleType
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

import firmware_sim.cli
from hil.cli import app as cli
from hil.version import __version__
from tests.cli.cli_bench import CommandLine

NAMES = [module.__name__.rpartition(".")[2] for module in cli.COMMANDS]


def test_the_help_of_hil_begins_with_an_example_and_lists_every_command(command_line: CommandLine) -> None:
    out = command_line("hil", "--help").out
    assert out.index("Example: hil simulate paper") < out.index("Options")
    assert all(re.search(rf"^│ {name} ", out, re.MULTILINE) for name in NAMES)


@pytest.mark.parametrize("module", cli.COMMANDS, ids=NAMES)
def test_every_command_has_an_example_at_the_head_of_its_help(module: ModuleType, command_line: CommandLine) -> None:
    name = module.__name__.rpartition(".")[2]
    out = command_line("hil", name, "--help").out
    lines = [line.strip() for line in out.splitlines() if line.strip()]
    assert lines[0].startswith("Usage: hil ")
    assert lines[1] == f"Example: {module.EXAMPLE}"


@pytest.mark.parametrize("module", cli.COMMANDS, ids=NAMES)
def test_every_example_is_a_command_line_that_the_command_takes(module: ModuleType) -> None:
    program, name, *arguments = shlex.split(module.EXAMPLE)
    assert program == "hil"
    group: Any = typer.main.get_command(cli.app)
    command = group.commands[name]
    command.make_context(name, arguments)  # raises for an option or argument that there is not


def words_of_help(command: Any) -> set[str]:
    """All words, option names and placeholders that the help of a command has to show."""
    texts = [command.help or ""]
    for parameter in command.params:
        texts += [getattr(parameter, "help", None) or "", parameter.metavar or ""]
        texts += [*parameter.opts, *parameter.secondary_opts] if parameter.param_type_name == "option" else []
    return {word for text in texts for word in text.split()}


@pytest.mark.parametrize("columns", [60, 80, *(pytest.param(wide, marks=pytest.mark.long) for wide in (79, 100))])
@pytest.mark.parametrize("name", ["hil", *(f"hil {name}" for name in NAMES), "firmware-sim"])
def test_help_is_whole_in_a_narrow_terminal(
    name: str, columns: int, command_line: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 60 columns the boxes used to cut off options, paths and placeholders: "runs/<time>_…", "--no-rep…"."""
    monkeypatch.setenv("COLUMNS", str(columns))
    program, *command = name.split()
    out = command_line(program, *command, "--help").out
    assert "Example: " in out
    assert max(map(len, out.splitlines())) <= columns
    assert "…" not in out
    group: Any = typer.main.get_command(cli.app if program == "hil" else firmware_sim.cli.app)
    words = words_of_help(group.commands[command[0]] if command else group)
    shown = re.sub(r"-\n[ │]*", "-", out)  # a word may be divided at its hyphen
    assert [word for word in words if word not in shown] == []


@pytest.mark.parametrize("name", ["hil", "firmware-sim"])
def test_both_programs_show_their_version(name: str, command_line: CommandLine) -> None:
    """`firmware-sim --version` used to be an unknown option."""
    result = command_line(name, "--version")
    assert (result.code, result.out, result.err) == (0, f"{name} {__version__}\n", "")


def test_help_in_a_wide_terminal_has_boxes(command_line: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert "╭─ Options ─" in command_line("hil", "run", "--help").out
    monkeypatch.setenv("TERMINAL_WIDTH", "60")
    assert "╭─ Options ─" not in command_line("hil", "run", "--help").out


def test_design_fits_sixty_columns(command_line: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its tables used to be cut off: 87 columns wide."""
    monkeypatch.setenv("COLUMNS", "60")
    out = command_line("hil", "design").out
    assert max(map(len, out.splitlines())) <= 60
    assert "…" not in out
    assert "pump 1  18.9415 -17.9738  -0.8970  -1.5420  -0.5220   0.2806" in out, "a row of gains is one line"


def test_a_new_command_is_its_module_and_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two files: the module in `hil/cli/commands`, and its row in the table of `hil.cli.app`."""

    def levels(tank: int = 1) -> None:
        """Show a tank.

        With more words.
        """
        typer.echo(f"tank {tank}")

    module = ModuleType("hil.cli.commands.levels")
    vars(module).update(levels=levels, EXAMPLE="hil levels --tank 2")
    table = typer.Typer()
    monkeypatch.setattr(cli, "app", table)
    cli._add(module)
    table.command("other")(lambda: None)
    runner = CliRunner()
    assert runner.invoke(table, ["levels", "--tank", "2"]).output == "tank 2\n"
    assert "Example: hil levels --tank 2" in runner.invoke(table, ["levels", "--help"]).output
    assert "Show a tank." in runner.invoke(table, ["--help"]).output
