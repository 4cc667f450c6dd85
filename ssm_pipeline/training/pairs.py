"""The order in which pairs of shapes are trained on. It depends only on the seed."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence

import numpy as np

MOST_LISTED = 1_000_000  # pairs; of more no training sees every one, and each is drawn by itself


class Pairs:
    """All unordered pairs of shapes of one family, in an order that the seed decides.

    Every pair once an epoch, each epoch in a new order; of more than MOST_LISTED pairs, each by a
    draw of its own, so that neither time nor memory grow with their number. The loss is symmetric:
    the other order of a pair would teach the same again.

    >>> pairs = Pairs(["lung", "tube", "lung", "lung"], seed=0)
    >>> len(pairs), sorted(pairs.at(index) for index in range(3))
    (3, [(0, 2), (0, 3), (2, 3)])
    """

    def __init__(self, families: Sequence[str], seed: int, most_listed: int = MOST_LISTED) -> None:
        self.families, self.seed = list(families), seed
        sizes = [self.families.count(family) for family in set(self.families)]
        self.count = sum(size * (size - 1) // 2 for size in sizes)
        self.listed = None if self.count > most_listed else self._all()

    def __len__(self) -> int:
        return self.count

    def at(self, index: int) -> tuple[int, int]:
        """The pair that comes after `index` others."""
        if self.listed is None:
            return self._drawn(np.random.default_rng([self.seed, index]))
        epoch, position = divmod(index, self.count)
        result: tuple[int, int] = self.listed[_order(self.seed, epoch, self.count)[position]]
        return result

    def _all(self) -> list[tuple[int, int]]:
        every = itertools.combinations(range(len(self.families)), 2)
        return [(x, y) for x, y in every if self.families[x] == self.families[y]]

    def _drawn(self, generator: np.random.Generator) -> tuple[int, int]:
        while True:
            x, y = sorted(generator.choice(len(self.families), 2, replace=False).tolist())
            if self.families[x] == self.families[y]:
                return x, y


@functools.lru_cache(maxsize=2)  # one after the other, and a step may lie in two
def _order(seed: int, epoch: int, count: int) -> np.ndarray:
    return np.random.default_rng([seed, epoch]).permutation(count)
