"""The command line. Prints libFuzzer's statistics, or the failure and the input that caused it."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path


def main() -> int:
    """Run one target for a time; a failing input is kept in the corpus folder, and can be repeated with --again."""
    parser = argparse.ArgumentParser("python -m tools.fuzz", description="Feed bytes to what reads them.")
    parser.add_argument("target", choices=("slcan", "wire", "adapter"))
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument(
        "--corpus", type=Path, help="folder of inputs to start from and add to; default: a temporary one"
    )
    parser.add_argument("--again", type=Path, metavar="INPUT", help="only try this input")
    options = parser.parse_args()
    try:
        import atheris
    except ImportError:
        parser.error("needs atheris, which is there for Linux on x86-64")
    with atheris.instrument_imports(include=["hil.edge.can.slcan_lines", "hil.wire", "firmware_sim.slcan_port"]):
        from tools.fuzz.targets import SEEDS, TARGETS
    corpus = options.corpus or Path(tempfile.mkdtemp(prefix="fuzz-"))
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(SEEDS[options.target]):
        (corpus / f"seed{number}").write_bytes(seed)
    how = (
        [str(options.again)] if options.again else [f"-max_total_time={options.seconds}", "-max_len=4096", str(corpus)]
    )
    # one process, whose statistics are printed at its end
    atheris.Setup(
        [sys.argv[0], "-print_final_stats=1", f"-artifact_prefix={corpus}/failed-", *how], TARGETS[options.target]
    )
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main())
