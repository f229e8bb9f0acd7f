"""examples/jumpstarter: Jumpstarter's own exporter and client on the bus of `meshpoint up`, by
configuration alone."""

from __future__ import annotations

import runpy
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
from jumpstarter.common.utils import env
from jumpstarter.config.exporter import ExporterConfigV1Alpha1

sys.path.insert(0, str(Path(__file__).parent))

from live_command import live

EXAMPLE = Path(__file__).parents[2] / "examples" / "jumpstarter"


@pytest.fixture
def exported(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The exporter at work on a bus of its own, and the environment as in a `jmp shell`."""
    with tempfile.TemporaryDirectory(prefix="mpj-") as folder:  # a socket's path must be short
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        config = ExporterConfigV1Alpha1.load_path(EXAMPLE / "exporter.yaml")
        with config.serve_unix() as path:
            monkeypatch.setenv("JUMPSTARTER_HOST", str(path))
            monkeypatch.setenv("JMP_DRIVERS_ALLOW", "UNSAFE")
            yield


@pytest.mark.usefixtures("exported")
def test_a_gear_asked_for_through_jumpstarter_engages(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main: Callable[[int], int] = runpy.run_path(str(EXAMPLE / "request_gear.py"))["main"]
    with live(tmp_path, "up") as nodes:
        nodes.until_said("in gear 8, ready")
        assert main(10) == 0
        nodes.until_said("shift 8 -> 10: engaged")
    assert capsys.readouterr().out == "in gear 10\n"


@pytest.mark.usefixtures("exported")
def test_its_client_hears_what_it_has_asked_for_alone() -> None:
    with env() as client, can.Bus(interface="meshpoint") as node:
        client.can.set_filters([{"can_id": 0x100, "can_mask": 0x700, "extended": True}])
        sent = [
            can.Message(arbitration_id=can_id, data=bytes(64), is_fd=True)
            for can_id in range(0, 0x200, 0x80)
        ]
        for message in sent:
            node.send(message)
        for message in sent[2:]:
            assert client.can.recv(60.0).equals(message, timestamp_delta=None, check_channel=False)
