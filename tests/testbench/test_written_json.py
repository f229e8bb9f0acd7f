"""JSON results are written whole or not at all."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path

import pytest

from meshpoint.base.errors import CommandError
from meshpoint.results.output import write_json


def test_an_error_amid_the_text_leaves_the_old_results(tmp_path: Path) -> None:
    out = tmp_path / "run.json"
    write_json(str(out), {"shifts": [1, 2]})
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(str(out), {"a": list(range(1000)), "z": float("nan")})
    assert json.loads(out.read_text(encoding="utf-8")) == {"shifts": [1, 2]}
    assert list(tmp_path.iterdir()) == [out]


def test_a_link_s_target_is_written_and_the_link_stays(tmp_path: Path) -> None:
    real, link = tmp_path / "real.json", tmp_path / "link.json"
    link.symlink_to(real)
    write_json(str(link), {"a": 1})
    assert link.is_symlink()
    assert json.loads(real.read_text(encoding="utf-8")) == {"a": 1}


@pytest.mark.skipif(os.name != "posix", reason="pipes with a name are of POSIX")
def test_a_pipe_is_written_to_and_stays_a_pipe(tmp_path: Path) -> None:
    pipe, read = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: read.append(pipe.read_text(encoding="utf-8")))
    reader.start()
    write_json(str(pipe), {"a": 1})
    reader.join()
    assert json.loads(read[0]) == {"a": 1}
    assert pipe.is_fifo()


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(CommandError, match=r"none.*cannot be written"):
        write_json(str(tmp_path / "none" / "run.json"), {"a": 1})
