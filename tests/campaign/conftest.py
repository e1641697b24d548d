"""For `campaign_bench`, and what is made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.campaigns.cases import Case
from tests.campaign.campaign_bench import SHORT, first_case


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
