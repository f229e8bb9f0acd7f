"""What a release is asked before it goes out: docs/releasing.md.

    python tools/release.py lacks [TAG]     what this commit lacks of a release (TAG)
    python tools/release.py content FOLDER  are source archive and wheel complete, alone, small
    python tools/release.py tag             tags this commit and pushes the tag
    python tools/release.py notes           CHANGELOG's section of this version
    python tools/release.py owner NAME      puts the owner's name in the placeholder's stead

Ends with 1 where something is wrong, and says what.
"""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath

from rules import PRODUCT, ROOT
from rules.releases import version

PLACEHOLDER = re.compile(r"\bOWNER(?=/meshpoint|\.github\.io)")
"""In addresses, as long as the owner is not known."""
MEANT = ("tests/", "tools/release.py")
"""Where the placeholder itself is spoken of."""
WITH_SOURCES = ("LICENSE", "README.md", "pyproject.toml", "setup.py", "constraints.txt", "Makefile")
NEVER = {".git", ".venv", "out", "build", "__pycache__", ".pytest_cache", ".hypothesis"}
MOST_BYTES = {".whl": 6_000_000, ".gz": 6_000_000}
"""Twice what they have today: what grows beyond it is looked at."""


# ------------------------------------------------------------ is it ready ----


def lacking(
    files: Iterable[tuple[str, str]], changelog: str, citation: str, number: str
) -> Iterator[str]:
    """What a version lacks of a release: names and texts of the files, and what they say of it."""
    for name, text in files:
        for line, words in enumerate(text.splitlines(), 1):
            if PLACEHOLDER.search(words):
                yield f"{name}:{line}: the placeholder OWNER"
    dated = re.search(
        rf"^## \[{re.escape(number)}\] - (\d{{4}}-\d\d-\d\d)$", changelog, re.MULTILINE
    )
    if not dated:
        yield f"CHANGELOG.md: [{number}] has no date"
    elif f"\ndate-released: {dated[1]}\n" not in citation:
        yield f"CITATION.cff: no line `date-released: {dated[1]}`, the date of CHANGELOG.md"


def spoken() -> Iterator[tuple[Path, str]]:
    """The files of the repository that are text, but those which speak of the placeholder."""
    for name in _git("ls-files", "-z").split("\0"):
        path = ROOT / name
        if name and not name.startswith(MEANT) and path.is_file():
            with contextlib.suppress(UnicodeDecodeError):
                yield path, path.read_text("utf-8")


def owner(name: str) -> None:
    """Puts the owner's name in."""
    for path, text in spoken():
        if PLACEHOLDER.search(text):
            path.write_text(PLACEHOLDER.sub(name, text), "utf-8")
            print(f"named: {path.relative_to(ROOT)}")


def lacks(tag: str | None = None) -> list[str]:
    """What this tree lacks of a release."""
    texts = ((path.relative_to(ROOT).as_posix(), text) for path, text in spoken())
    changelog, citation = (
        (ROOT / name).read_text("utf-8") for name in ("CHANGELOG.md", "CITATION.cff")
    )
    found = list(lacking(texts, changelog, citation, version()))
    if tag is not None and tag != f"v{version()}":
        found.append(f"pyproject.toml: version {version()}, but the tag is {tag}")
    return found


def notes(changelog: str, number: str) -> str:
    """The section of a version, without its heading."""
    section = re.search(
        rf"^## \[{re.escape(number)}\].*?\n(.*?)(?=^## |\Z)", changelog, re.MULTILINE | re.DOTALL
    )
    if section is None:
        raise ValueError(f"CHANGELOG.md: no section [{number}]")
    return section[1].strip()


# --------------------------------------------------------- is it complete ----


def members(archive: Path) -> set[PurePosixPath]:
    """Files of a source archive, without its folder, or of a wheel."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as wheel:
            return {PurePosixPath(name) for name in wheel.namelist() if not name.endswith("/")}
    with tarfile.open(archive) as sources:
        named = [PurePosixPath(each.name) for each in sources if not each.isdir()]
    return {PurePosixPath(*name.parts[1:]) for name in named}


def wrong_with(archive: Path, tracked: Iterable[str]) -> Iterator[str]:
    """What is missing in a source archive or a wheel, what does not belong there, what is large."""
    held, of_package = members(archive), {PurePosixPath(name) for name in tracked}
    of_package = {path for path in of_package if path.parts[0] in PRODUCT}
    if archive.suffix == ".whl":
        beside = of_package - {path for path in of_package if path.parts[0] == "meshpoint"}
        wanted = of_package - beside | {PurePosixPath("meshpoint", path) for path in beside}
    else:
        wanted = of_package | {PurePosixPath(name) for name in WITH_SOURCES}
    for path in sorted(wanted - held):
        yield f"{archive.name}: lacks {path}"
    for path in sorted(held):
        if NEVER & set(path.parts) or path.suffix == ".pyc":
            yield f"{archive.name}: has {path}"
    most = MOST_BYTES[archive.suffix]
    if archive.stat().st_size > most:
        yield f"{archive.name}: {archive.stat().st_size:,} bytes, more than {most:,}"


def content(folder: Path) -> list[str]:
    """What is wrong with what was built."""
    start = f"meshpoint-{version()}"
    built = sorted(path for path in folder.iterdir() if path.suffix in MOST_BYTES)
    found = [f"{path.name}: not of {start}" for path in built if not path.name.startswith(start)]
    found += [
        f"{folder}: no {each}" for each in MOST_BYTES if each not in {b.suffix for b in built}
    ]
    tracked = [name for name in _git("ls-files", "-z").split("\0") if name]
    for path in built:
        print(f"{path.name}: {len(members(path))} files, {path.stat().st_size / 1e6:.1f} MB")
        found += wrong_with(path, tracked)
    return found


# ------------------------------------------------------------ it goes out ----


def tag() -> list[str]:
    """Tags this commit and pushes the tag, or says why not; .github/workflows/release.yml does the
    rest."""
    name, found = f"v{version()}", lacks()
    if _git("status", "--porcelain"):
        found.append("files that are not committed")
    if _git("tag", "--list", name):
        found.append(f"{name} has been tagged before")
    if not found:
        _git("tag", "--annotate", name, "--message", f"meshpoint {version()}")
        _git("push", "origin", name)
        print(f"{name} is pushed: its workflow publishes it")
    return found


def _git(*words: str) -> str:
    done = subprocess.run(  # noqa: S603
        ["git", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True  # noqa: S607
    )  # fmt: skip
    return done.stdout


def main(argv: list[str]) -> int:
    """Runs one of the five."""
    match argv:
        case ["lacks", *given] if len(given) <= 1:
            found = lacks(*given)
        case ["content", folder]:
            found = content(Path(folder))
        case ["tag"]:
            found = tag()
        case ["notes"]:
            found = []
            print(notes((ROOT / "CHANGELOG.md").read_text("utf-8"), version()))
        case ["owner", name] if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9-]*", name):
            found = []
            owner(name)
        case _:
            print(__doc__, file=sys.stderr)
            return 2
    for each in found:
        print(each, file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
