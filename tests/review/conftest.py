"""Runs of the toy loop, made once."""

from __future__ import annotations

import pytest

from hil.edge.record.run_folder import RunFolder
from tests.review import toy


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return toy.record_run(tmp_path_factory.mktemp("runs") / "whole", with_rerun=True)


@pytest.fixture(scope="session")
def run_without_reconfiguration(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return toy.record_run(tmp_path_factory.mktemp("runs") / "no_reconfiguration", reconfigure=False)
