"""The shape of the product, counted: files, lines, rooms, floors and arrows of controller, rig and
bench.

    room    a folder of a package, or a module beside its folders; of the bench, a package of
            meshpoint/ that is none of `NO_ROOMS`
    arrow   one room imports another
    floors  rooms on the longest way along arrows: what has to be known from bottom to top
    inside  modules of rooms, and how many of them others than the package itself import

    make shape, or tools/linked-tree && python tools/shape.py [--mermaid controller]

--mermaid: the rooms of a package and their arrows, as a graph in Mermaid's language. What a step
enters is counted by `python -m benchmarks.bench_step`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import grimp

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("controller", "rig_sim", "dbc", "firmware", "meshpoint")
BENCH = "meshpoint"
WITH_ROOMS = ("controller", "rig_sim", BENCH)
NO_ROOMS = ("api", "bus", "gearbox", "kernels")
"""Packages of meshpoint/ that are no rooms of the bench: it stands on three, the API on it."""


class Shape(NamedTuple):
    """The figures of a package with rooms."""

    rooms: int
    floors: int
    arrows: int
    modules: int
    reached: int
    """Modules of rooms that others import."""


@cache
def bench_rooms() -> frozenset[str]:
    """The packages that make up the bench."""
    found = {path.parent.name for path in (ROOT / BENCH).glob("*/__init__.py")}
    return frozenset(found.difference(NO_ROOMS))


def room_of(module: str, package: str) -> str | None:
    """The room that a module lies in; None outside of the package."""
    if package == BENCH:
        room = module.partition(".")[2].partition(".")[0]
        return room if room in bench_rooms() else None
    if not module.startswith(f"meshpoint.{package}."):
        return None
    return module.split(".")[2]


def arrows_of(graph: grimp.ImportGraph, package: str) -> set[tuple[str, str]]:
    """Which room imports which."""
    found = set()
    for importer, imported in _imports(graph):
        rooms = room_of(importer, package), room_of(imported, package)
        if rooms[0] and rooms[1] and rooms[0] != rooms[1]:
            found.add((rooms[0], rooms[1]))
    return found


def shape_of(graph: grimp.ImportGraph, package: str) -> Shape:
    """The figures of a package with rooms."""
    mine = {each for each in graph.modules if room_of(each, package)}
    inside = {each for each in mine if each.count(".") > (1 if package == BENCH else 2)}
    arrows = arrows_of(graph, package)
    reached = {b for a, b in _imports(graph) if b in inside and a not in mine}
    rooms = {room_of(each, package) for each in mine}
    return Shape(len(rooms), _floors(arrows), len(arrows), len(inside), len(reached))


def _imports(graph: grimp.ImportGraph) -> Iterator[tuple[str, str]]:
    for importer in graph.modules:
        for imported in graph.find_modules_directly_imported_by(importer):
            yield importer, imported


def _lines(package: str) -> tuple[int, int]:
    files = list((ROOT / package).rglob("*.py"))
    return sum(len(path.read_text("utf-8").splitlines()) for path in files), len(files)


def _floors(arrows: set[tuple[str, str]]) -> int:
    @cache
    def height(room: str) -> int:
        return 1 + max((height(below) for above, below in arrows if above == room), default=0)

    return max((height(room) for room, _ in arrows), default=0)


def main(argv: list[str] | None = None) -> int:
    """Prints them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mermaid", choices=WITH_ROOMS)
    namespace = parser.parse_args(argv)
    sys.path.insert(0, str(ROOT / "build" / "tree"))
    graph = grimp.build_graph("meshpoint", cache_dir=None)
    if namespace.mermaid:
        print("flowchart TD")
        for above, below in sorted(arrows_of(graph, namespace.mermaid)):
            print(f"    {above} --> {below}")
        return 0
    for package in PACKAGES:
        lines, files = _lines(package)
        print(f"{package:11} {files:4} files, {lines:6} lines", end="")
        if package in WITH_ROOMS:
            of = shape_of(graph, package)
            print(
                f", {of.rooms:3} rooms, {of.floors:2} floors, {of.arrows:3} arrows; of "
                f"{of.modules} modules inside others reach {of.reached}",
                end="",
            )
        print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
