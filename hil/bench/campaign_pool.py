"""Where the runs of a campaign are executed: in this process, by Dask on all cores, or on a running Dask cluster.

The same function makes a run in all of them, and a run's result depends on nothing but its case.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hil.bench.campaign_case import run_case
from hil.campaigns import outcome
from hil.campaigns.cases import Case
from hil.campaigns.row import Elapsed, Row
from hil.edge.config.settings_file import SettingsError

INSTALL = "pip install 'fourtank-hil[campaign]'"
CONNECT_S = 10.0


def has_dask() -> bool:
    """Whether Dask with its cluster is installed."""
    return find_spec("dask") is not None and find_spec("distributed") is not None


def processes_for(processes: int | None, scheduler: str | None) -> int:
    """Number of processes to use: the requested one, else one for each core, or one without Dask.

    Raises SettingsError when Dask is needed and isn't there.
    """
    if has_dask():
        return processes or os.cpu_count() or 1
    if scheduler is not None or (processes or 1) > 1:
        asked = "--scheduler" if scheduler is not None else f"--processes {processes}"
        raise SettingsError(f"{asked} needs Dask, which is not installed: {INSTALL}")
    return 1


def run_all(cases: Sequence[Case], config_dir: Path, processes: int, scheduler: str | None) -> Iterator[Row]:
    """Yield each row when its run ends. Raises SettingsError when the scheduler can't be reached."""
    if scheduler is None and processes == 1:
        return (run_case(case, config_dir) for case in cases)
    return _over_dask(cases, config_dir, processes, scheduler)


def _over_dask(cases: Sequence[Case], config_dir: Path, processes: int, scheduler: str | None) -> Iterator[Row]:
    distributed = _distributed()
    with ExitStack() as stack:
        client = _client(stack, min(processes, len(cases)), scheduler)
        futures = {client.submit(run_case, case, config_dir, key=f"hil-{case.key}"): case for case in cases}
        for future in distributed.as_completed(list(futures)):
            case = futures.pop(future)
            error = future.exception()
            if error is None:
                yield future.result()
            else:  # its worker was killed repeatedly
                yield outcome.crash(
                    case, error if isinstance(error, Exception) else RuntimeError(str(error)), Elapsed(0.0, 0.0)
                )
            future.release()


def _client(stack: ExitStack, processes: int, scheduler: str | None) -> Any:
    distributed = _distributed()
    if scheduler is not None:
        try:
            return stack.enter_context(distributed.Client(scheduler, timeout=CONNECT_S))
        except (OSError, ValueError, TimeoutError) as error:
            raise SettingsError(f"--scheduler {scheduler}: can't be reached: {error}") from None
    cluster = distributed.LocalCluster(
        n_workers=processes,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        silence_logs=logging.ERROR,
    )
    return stack.enter_context(distributed.Client(stack.enter_context(cluster)))


def _distributed() -> Any:
    """Dask's cluster module; optional, and without types."""
    return import_module("dask.distributed")
