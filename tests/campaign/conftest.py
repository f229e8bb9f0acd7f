"""Makes this folder's helper importable; a Dask cluster."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from patience import HANG_S

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def cluster() -> Iterator[str]:
    import dask
    from dask.distributed import LocalCluster

    # A busy machine may take long to start a worker; none but a hang takes so long.
    patient = {f"distributed.comm.timeouts.{which}": f"{HANG_S:g}s" for which in ("connect", "tcp")}
    # Work that ends its worker is not tried again: a worker takes seconds to start.
    with (
        dask.config.set(patient | {"distributed.scheduler.allowed-failures": 0}),
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
        ) as local,
    ):
        yield local.scheduler_address
