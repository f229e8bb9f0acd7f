"""Tests with Vector SIL Kit: where silkit-py is installed, as `make silkit` does in a Python that
has it; elsewhere skipped, with the reason."""

from __future__ import annotations

import socket
import subprocess
from collections.abc import Iterator

import pytest
from patience import until

from meshpoint.bus.silkit.library import SilKitError, join


class Registry:
    """SIL Kit's registry on a port of its own."""

    def __init__(self, executable: object) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.uri = f"silkit://127.0.0.1:{free.getsockname()[1]}"
        self.process = subprocess.Popen(
            [str(executable), "--listen-uri", self.uri, "--log", "off"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        until(self._answers, "a registry")

    def _answers(self) -> bool:
        try:
            join("first", self.uri)
        except SilKitError:
            return False
        return True

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


@pytest.fixture
def registry() -> Iterator[Registry]:
    why = "silkit-py is for Python 3.12 and newer: `make silkit`"
    made = Registry(
        pytest.importorskip("SilKit_py.tools", reason=why).executable("sil-kit-registry")
    )
    yield made
    made.end()
