"""python-can's own tools find the local bus by its entry point."""

import subprocess
import time
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path

import can
import pytest
from patience import Patience

from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.bus.logs.reader import read_log

installed = pytest.mark.skipif(
    "meshpoint" not in entry_points(group="can.interface").names,
    reason="the package is not installed, so python-can does not know its interface",
)


pytestmark = pytest.mark.check


@installed
def test_can_logger_records_the_local_bus(
    common_channel: str,
    join: Callable[..., MeshpointBus],
    start: Callable[..., subprocess.Popen[str]],
    tmp_path: Path,
) -> None:
    log = tmp_path / "bus.log"
    sender = join()
    logger = start("-m", "can.logger", "-i", "meshpoint", "-c", common_channel, "-f", str(log))
    patience = Patience()
    number = 0
    while not (log.exists() and log.stat().st_size > 20_000):
        assert logger.poll() is None
        patience.check("a log of 20 kB by can.logger")
        sender.send(can.Message(arbitration_id=number, data=bytes(64), is_fd=True))
        number += 1
        time.sleep(0.001)
    logger.terminate()
    logger.wait()
    content = log.read_text().rpartition("\n")[0] + "\n"
    log.write_text(content)
    found = [frame.can_id for _, frame in read_log(log)]
    assert found == list(range(found[0], found[0] + len(found)))
