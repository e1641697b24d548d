"""A picture of a run's recording without a screen: `python tools/screenshot.py FOLDER OUT.png`.

Uses Rerun's own command line with a software Vulkan driver (Debian: `apt-get install mesa-vulkan-drivers`).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

WINDOW = "1600x1000"


def screenshot(recording: Path, picture: Path, *, window: str = WINDOW, timeout_s: float = 120.0) -> None:
    """Draw the recording as it opens. Raises RuntimeError when no picture comes out, subprocess.TimeoutExpired when stuck."""
    command = [sys.executable, "-m", "rerun_cli", str(recording), "--headless", "--bind", "127.0.0.1", "--port", "auto"]
    command += ["--screenshot-to", str(picture), "--window-size", window, "--renderer", "vulkan"]
    picture.unlink(missing_ok=True)
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)
    if done.returncode != 0 or not picture.is_file():
        raise RuntimeError(f"no picture came out (is a Vulkan driver installed?)\n{done.stderr.strip()[-2000:]}")


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, help="run folder, or an .rrd file")
    parser.add_argument("picture", type=Path, help="where the PNG goes")
    parser.add_argument("--window", default=WINDOW, help="size in pixels (default: %(default)s)")
    options = parser.parse_args()
    recording = options.folder / "run.rrd" if options.folder.is_dir() else options.folder
    try:
        screenshot(recording, options.picture, window=options.window)
    except (RuntimeError, subprocess.TimeoutExpired) as error:
        print(error, file=sys.stderr)
        return 1
    print(options.picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
