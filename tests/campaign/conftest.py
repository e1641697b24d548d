"""For `campaign_bench`, and what is made once."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from campaign_bench import SHORT, first_case

from hil.campaign.cases import Case


@pytest.fixture
def scenario_file(tmp_path: Path) -> Path:
    file = tmp_path / "short.toml"
    file.write_text(SHORT)
    return file


@pytest.fixture(scope="session")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    file = tmp_path_factory.mktemp("scenario") / "short.toml"
    file.write_text(SHORT)
    return first_case(file)
