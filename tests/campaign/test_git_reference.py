"""The files of a commit, for a comparison with it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from meshpoint.campaigns.git_reference import export, find_commit


def test_a_link_out_of_the_checkout_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a repository has one that holds a virtual environment."""
    checkout, exported = tmp_path / "checkout", tmp_path / "exported"
    checkout.mkdir()
    (checkout / "controller.toml").write_text("here")
    (checkout / "python").symlink_to("/usr/bin/python3")
    (checkout / "up").symlink_to("../beside")
    monkeypatch.chdir(checkout)
    who = ["-c", "user.name=someone", "-c", "user.email=someone@example.com"]
    for command in (["init", "-q"], ["add", "."], [*who, "commit", "-qm", "first"]):
        subprocess.run(["git", *command], check=True)
    assert not export(find_commit("HEAD"), exported), "the product is not in it"
    assert [path.name for path in exported.iterdir()] == ["controller.toml"]
