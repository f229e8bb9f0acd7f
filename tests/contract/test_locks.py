"""locks/ has the packages of constraints.txt with digests; all that CI fetches is pinned."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LOCKS = sorted((ROOT / "locks").glob("*.txt"))
EXTRAS = ("test", "notebook", "firmware", "docs", "release")
PIN = re.compile(r"([\w.-]+)==([\w.]+)")


def named(package: str) -> str:
    """As package indexes compare names."""
    return re.sub(r"[-_.]+", "-", package).lower()


def pins(path: Path) -> dict[str, str]:
    lines = path.read_text(encoding="utf-8").splitlines()
    return {named(found[1]): found[2] for line in lines if (found := PIN.match(line))}


def requirements(lock: Path) -> list[str]:
    """Each with its digests, in one line."""
    text = lock.read_text(encoding="utf-8").replace("\\\n", " ")
    return [line for line in text.splitlines() if line and not line.startswith("#")]


def test_every_pin_of_constraints_is_in_one_lock_with_its_version() -> None:
    assert {path.stem for path in LOCKS} == {"build", "run", *EXTRAS}
    locked: dict[str, str] = {}
    for lock in LOCKS:
        assert not locked.keys() & pins(lock).keys(), "a package is in one of them"
        locked |= pins(lock)
    constraints = pins(ROOT / "constraints.txt")
    assert len(constraints) > 80
    assert locked == constraints


@pytest.mark.parametrize("lock", LOCKS, ids=lambda path: path.stem)
def test_everything_in_a_lock_has_digests_and_nothing_else(lock: Path) -> None:
    """No address of an index either: where packages come from is each user's own setting."""
    requirement = re.compile(r"[\w.-]+==[\w.]+( ; [^\\]+?)?(\s+--hash=sha256:[0-9a-f]{64})+\s*")
    assert [each for each in requirements(lock) if not requirement.fullmatch(each)] == []


def test_the_wheel_has_the_versions_that_meshpoint_runs_with() -> None:
    done = subprocess.run(
        [sys.executable, "-S", "-m", "meshpoint.constraints"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stderr == "", "with nothing else installed"
    assert pins(Path(done.stdout.strip())) == pins(ROOT / "locks" / "run.txt")


def test_what_the_project_asks_for_is_locked() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    asked = {
        "build": project["build-system"]["requires"],
        "run": project["project"]["dependencies"],
    } | {name: project["project"]["optional-dependencies"][name] for name in EXTRAS}
    held: set[str] = set()
    for lock, wanted in asked.items():
        held |= pins(ROOT / "locks" / f"{lock}.txt").keys()
        names = {named(re.split(r"[<>=!~\[; ]", each)[0]) for each in wanted}
        assert names - held == set(), lock


# ------------------------------------------------------ actions and images ----

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
BUILT_HERE = {"meshpoint:local"}
"""Images that no registry has: docker-compose.yml and tools/test-containers build them."""
DEBOOTSTRAPPED = "debian:12.11-slim"
"""Made on the spot by tools/test-containers where there is only podman, so without a digest."""


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.name)
def test_every_action_is_a_commit_and_says_which_version_that_was(workflow: Path) -> None:
    used = re.findall(r"^\s*-?\s*uses: *(.*)$", workflow.read_text(encoding="utf-8"), re.MULTILINE)
    assert used
    used = [action for action in used if not action.startswith("./")]  # of this very commit
    pinned = re.compile(r"[\w./-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+")
    assert [action for action in used if not pinned.fullmatch(action)] == []


@pytest.mark.parametrize(
    ("file", "names"),
    [
        ("Dockerfile", r"^(?:FROM|ARG BASE=) *(\S+)"),
        ("docker-compose.yml", r"^\s*image: *(\S+)"),
        (".devcontainer/devcontainer.json", r'^\s*"image": *"(\S+)"'),
        (".github/workflows/ci.yml", r"^\s*(?:container|image): *(\S+)"),
    ],
)
def test_every_image_is_named_by_its_digest(file: str, names: str) -> None:
    text = (ROOT / file).read_text(encoding="utf-8").replace("ARG BASE=", "ARG BASE= ")
    images = set(re.findall(names, text, re.MULTILINE))
    assert images, file
    pinned = re.compile(r"[\w./:-]+@sha256:[0-9a-f]{64}")
    others = {image for image in images - BUILT_HERE if not pinned.fullmatch(image)}
    assert others <= {"$BASE"}


def test_the_image_made_on_the_spot_is_the_one_that_is_pulled_elsewhere() -> None:
    script = (ROOT / "tools" / "test-containers").read_text(encoding="utf-8")
    dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert f"base={DEBOOTSTRAPPED}\n" in script
    assert f"ARG BASE={DEBOOTSTRAPPED}@sha256:" in dockerfile
