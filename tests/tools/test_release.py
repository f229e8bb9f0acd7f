"""A release does not go out unfinished: tools/release.py says what a commit or an archive lacks."""

from __future__ import annotations

import io
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest
import release
from rules.releases import version

ROOT = Path(__file__).parents[2]
CHANGELOG = """# Changelog

## [Unreleased]

## [0.2.0] - 2027-01-31

### Added

- A gear.

## [0.1.0] - 2026-12-01

- A gearbox.
"""
CITATION = "version: 0.2.0\ndate-released: 2027-01-31\n"


def lacking(text: str, changelog: str = CHANGELOG, citation: str = CITATION) -> list[str]:
    return list(release.lacking([("a.toml", text)], changelog, citation, "0.2.0"))


def test_a_finished_version_lacks_nothing() -> None:
    assert lacking('Source = "https://github.com/somebody/meshpoint"\n') == []


@pytest.mark.parametrize(
    "address",
    ["https://github.com/OWNER/meshpoint", "https://OWNER.github.io/", "OWNER/meshpoint/actions"],
)
def test_an_address_of_nobody_is_named_with_its_line(address: str) -> None:
    assert lacking(f"\n{address}\n") == ["a.toml:2: the placeholder OWNER"]


def git(folder: Path, *words: str) -> str:
    done = subprocess.run(
        ["git", "-c", "user.name=A", "-c", "user.email=a@example.org", *words],
        cwd=folder, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished version, committed, with a place to push it to."""
    here = tmp_path / "here"
    here.mkdir()
    (here / "CHANGELOG.md").write_text(CHANGELOG, "utf-8")
    (here / "CITATION.cff").write_text(CITATION, "utf-8")
    (here / "README.md").write_text("https://github.com/somebody/meshpoint\n", "utf-8")
    git(tmp_path, "init", "--quiet", "--bare", "there")
    git(here, "init", "--quiet")
    git(here, "config", "user.name", "A")
    git(here, "config", "user.email", "a@example.org")
    git(here, "remote", "add", "origin", str(tmp_path / "there"))
    git(here, "add", ".")
    git(here, "commit", "--quiet", "--message", "0.2.0")
    monkeypatch.setattr(release, "ROOT", here)
    monkeypatch.setattr(release, "version", lambda: "0.2.0")
    return here


def test_the_owner_s_name_is_put_in_everywhere_and_then_nothing_is_lacking(
    repository: Path,
) -> None:
    page = repository / "README.md"
    page.write_text(
        "https://github.com/OWNER/meshpoint, https://OWNER.github.io/, OWNER\n", "utf-8"
    )
    assert release.main(["lacks"]) == 1
    assert release.main(["owner", "some-body"]) == 0
    assert page.read_text("utf-8") == (
        "https://github.com/some-body/meshpoint, https://some-body.github.io/, OWNER\n"
    )
    assert release.main(["lacks", "v0.2.0"]) == 0
    assert release.main(["owner", "some body"]) == 2


def test_a_finished_version_is_tagged_once_and_its_tag_is_pushed(
    repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert release.main(["tag"]) == 0
    assert git(repository.parent / "there", "tag") == "v0.2.0\n"
    assert release.main(["tag"]) == 1
    assert "v0.2.0 has been tagged before\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("not committed\n", "files that are not committed"),
        ("https://github.com/OWNER/meshpoint\n", "README.md:1: the placeholder OWNER"),
    ],
)
def test_an_unfinished_one_is_not_tagged(
    repository: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (repository / "README.md").write_text(text, "utf-8")
    assert release.main(["tag"]) == 1
    assert f"{said}\n" in capsys.readouterr().err
    assert git(repository, "tag") == git(repository.parent / "there", "tag") == ""


def test_a_version_has_one_date() -> None:
    undated = CHANGELOG.replace("2027-01-31", "not released")
    assert lacking("", changelog=undated) == ["CHANGELOG.md: [0.2.0] has no date"]
    (said,) = lacking("", citation="version: 0.2.0\ndate-released: 2027-01-30\n")
    assert said.startswith("CITATION.cff: no line `date-released: 2027-01-31`")


def test_the_repository_itself_says_what_it_lacks(capsys: pytest.CaptureFixture[str]) -> None:
    assert release.main(["lacks", "v99.0"]) == 1
    said = capsys.readouterr().err
    assert f"pyproject.toml: version {version()}, but the tag is v99.0\n" in said


def test_the_placeholder_of_the_project_s_addresses_is_one_that_is_found() -> None:
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    urls = project.split("[project.urls]\n")[1].split("\n\n")[0]
    owners = {"OWNER" in line for line in urls.splitlines()}
    assert len(owners) == 1, "the owner is named in all of them or in none"
    assert all(release.PLACEHOLDER.search(line) for line in urls.splitlines() if "OWNER" in line)


def test_the_notes_are_the_version_s_section_alone() -> None:
    assert release.notes(CHANGELOG, "0.2.0") == "### Added\n\n- A gear."
    assert release.notes(CHANGELOG, "0.1.0") == "- A gearbox."
    with pytest.raises(ValueError, match=r"no section \[0\.3\.0\]"):
        release.notes(CHANGELOG, "0.3.0")


# ------------------------------------------------------------- archives ----

TRACKED = ["controller/__init__.py", "meshpoint/__init__.py", "tests/test_it.py"]


def wheel(path: Path, *names: str) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, "")
    return path


def sources(path: Path, *names: str) -> Path:
    with tarfile.open(path, "w:gz") as archive:
        for name in names:
            archive.addfile(tarfile.TarInfo(f"meshpoint-0.2.0/{name}"), io.BytesIO())
    return path


def test_a_whole_wheel_is_one_in_which_all_lies_below_meshpoint(tmp_path: Path) -> None:
    whole = wheel(tmp_path / "a.whl", "meshpoint/__init__.py", "meshpoint/controller/__init__.py")
    assert list(release.wrong_with(whole, TRACKED)) == []
    other = wheel(tmp_path / "b.whl", "meshpoint/__init__.py", "controller/__init__.py")
    assert list(release.wrong_with(other, TRACKED)) == [
        "b.whl: lacks meshpoint/controller/__init__.py"
    ]


def test_a_source_archive_has_what_builds_it_and_nothing_that_was_made(tmp_path: Path) -> None:
    whole = sources(tmp_path / "a.tar.gz", *TRACKED, *release.WITH_SOURCES)
    assert list(release.wrong_with(whole, TRACKED)) == []
    made = "controller/__pycache__/core.cpython-311.pyc"
    other = sources(tmp_path / "b.tar.gz", *TRACKED, *release.WITH_SOURCES[1:], made)
    assert list(release.wrong_with(other, TRACKED)) == [
        f"b.tar.gz: lacks {release.WITH_SOURCES[0]}",
        f"b.tar.gz: has {made}",
    ]


def test_the_repository_has_no_links_of_which_an_archive_would_hold_copies() -> None:
    done = subprocess.run(
        ["git", "ls-files", "--stage"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert [line for line in done.stdout.splitlines() if line.startswith("120000 ")] == []


def test_what_has_grown_beyond_its_bound_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = wheel(tmp_path / "a.whl", "meshpoint/__init__.py", "meshpoint/controller/__init__.py")
    monkeypatch.setitem(release.MOST_BYTES, ".whl", small.stat().st_size - 1)
    (said,) = release.wrong_with(small, TRACKED)
    assert said.startswith("a.whl: ")
    assert "bytes, more than" in said
