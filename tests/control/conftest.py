from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.control.control_bench import Bench, control_bench


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with control_bench(tmp_path) as made:
        yield made
