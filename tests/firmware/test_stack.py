"""The stack of the board's image is bounded: the compiler's call graph says by how much."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from stack_bound import bound, call_graph, total_bytes

from meshpoint.firmware import build

pytestmark = pytest.mark.skipif(
    shutil.which("arm-none-eabi-gcc") is None, reason="gcc-arm-none-eabi is not installed"
)


@pytest.fixture(scope="module")
def sources() -> Path:
    return build.source_folder()


@pytest.mark.parametrize("image", build.IMAGES)
def test_main_loop_interrupt_and_fault_on_each_other_take_under_1_kb(
    sources: Path, image: str
) -> None:
    assert 100 < total_bytes(bound(call_graph(sources, image))) < 1024


def test_a_function_that_calls_itself_has_no_bound(sources: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(sources, tmp_path / "firmware")
    with (copy / "g474" / "startup.c").open("a") as file:
        file.write("int endless(int n);\n")
        file.write("int endless(int n) { return n < 2 ? n : endless(n - 1) + endless(n - 2); }\n")
    with pytest.raises(RecursionError):
        call_graph(copy).deepest("endless")
