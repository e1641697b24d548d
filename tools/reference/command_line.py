"""Page of every command with its arguments and options, from the commands themselves."""

from __future__ import annotations

import re
from typing import Any

import typer

from firmware_sim.cli import app as emulator_app
from hil.cli.app import app as hil_app
from tools.reference.markdown import code, table


def command_line_page() -> str:
    """The whole page."""
    hil: Any = typer.main.get_command(hil_app)
    parts = ["# Command line\n\nEvery command explains itself with `--help`.\n"]
    if hil.epilog:
        parts.append(f"\n{_text(hil.epilog)}\n")
    for name, command in hil.commands.items():
        parts.append(_section(f"hil {name}", command))
    parts.append(_section("firmware-sim", typer.main.get_command(emulator_app)))
    return "".join(parts)


def _section(title: str, command: Any) -> str:
    arguments = [one for one in command.params if one.param_type_name == "argument"]
    options = [
        one for one in command.params if one.param_type_name == "option" and one.name != "help" and not one.hidden
    ]
    usage = " ".join([title, *(_argument(one) for one in arguments), "[OPTIONS]"])
    parts = [f"\n## {title}\n\n{_text(command.help or '')}\n\n```text\n{usage}\n```\n"]
    if arguments:
        rows = [(code(one.metavar or one.name), _text(one.help or "")) for one in arguments]
        parts.append("\n" + table(("argument", "meaning"), rows))
    if options:
        listed = [
            (", ".join(map(code, (*one.opts, *one.secondary_opts))), _default(one), _text(one.help or ""))
            for one in options
        ]
        parts.append("\n" + table(("option", "default", "meaning"), listed))
    if command.epilog:
        parts.append(f"\n{_text(command.epilog)}\n")
    return "".join(parts)


def _argument(one: Any) -> str:
    name = one.metavar or one.name.upper()
    return name if one.required else f"[{name}]"


def _default(one: Any) -> str:
    if one.required:
        return "required"
    if isinstance(one.default, bool):
        return "on" if one.default else "off"
    return "" if one.default is None else code(getattr(one.default, "value", one.default))


def _text(text: str) -> str:
    """Help text without the marks of rich, each paragraph in one line."""
    bare = re.sub(r"\[/?(?:bold|dim|italic|cyan|green|yellow|red)[^\]]*\]", "", text.replace("\b", ""))
    paragraphs = [" ".join(part.split()).replace("<", "&lt;") for part in re.split(r"\n\s*\n", bare.strip())]
    example = re.compile(r"^Example: (.*)$")
    return "\n\n".join(example.sub(r"Example: `\1`", part) for part in paragraphs)
