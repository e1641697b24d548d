"""Write every generated page into docs/reference, or the folder given. The pages are not in version control."""

from __future__ import annotations

import argparse
from pathlib import Path

from tools.reference import FOLDER
from tools.reference.pages import write_pages


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=FOLDER)
    write_pages(parser.parse_args().folder)


if __name__ == "__main__":
    main()
