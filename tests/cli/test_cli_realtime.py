"""What `hil run --realtime` refuses before anything moves."""

from pathlib import Path

import pytest

from tests.cli.cli_bench import CommandLine

SCENARIO = Path(__file__).resolve().parents[2] / "config/scenarios/steps.toml"


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--realtime", "--priority", "0"), "hil: --priority 0 is outside 1..99\n"),
        (("--realtime", "--priority", "100"), "hil: --priority 100 is outside 1..99\n"),
        (("--priority", "80"), "hil: --priority and --cpu belong to --realtime\n"),
        (("--realtime", "--cpu", "4096"), "hil: --cpu 4096 is not one of this process's processors: "),
    ],
)
def test_a_bad_request_is_one_line_and_makes_no_folder(
    command_line: CommandLine, tmp_path: Path, options: tuple[str, ...], says: str
) -> None:
    out = tmp_path / "run"
    result = command_line("hil", "run", SCENARIO, "-i", "virtual", "-c", "x", "--out", out, *options)
    assert result.code == 2
    assert result.err.startswith(says)
    assert result.err.count("\n") == 1
    assert not out.exists()
