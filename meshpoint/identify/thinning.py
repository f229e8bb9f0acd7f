"""A list of limited length out of any number of items, spread evenly over all of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Generic, TypeVar

Item = TypeVar("Item")
MOST: Final = 256


class Thinned(Generic[Item]):
    """Keeps every item up to `most`; then every second, every fourth, and so on."""

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._every = 1
        self._items: list[Item] = []
        self.seen = 0
        """How many there were."""

    def add(self, item: Item) -> None:
        """One more."""
        if self.seen % self._every == 0:
            if len(self._items) == self._most:
                del self._items[1::2]
                self._every *= 2
            if self.seen % self._every == 0:
                self._items.append(item)
        self.seen += 1

    def __len__(self) -> int:
        return len(self._items)

    def __iter__(self) -> Iterator[Item]:
        return iter(self._items)

    def __getitem__(self, index: int) -> Item:
        return self._items[index]
