"""Shapes with known correspondences, and between which of them they are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal, Protocol

import numpy as np

from ssm_pipeline.records import KnownPair, Mesh, StudyError

Between = Literal["all", "within categories", "between categories"]


class ShapesWithTruth(Protocol):
    """What a benchmark needs of a set of shapes."""

    @property
    def meshes(self) -> tuple[Mesh, ...]: ...

    def known_pairs(self, shapes: Sequence[int], with_self_pairs: bool = False) -> list[KnownPair]:
        """The ordered pairs among these shapes whose correspondence is known."""
        ...


@dataclass(frozen=True, eq=False)
class MatchingSet:
    """Shapes that share one template, as FAUST_r.

    Attributes:
        template_to_shape: Per mesh (R,) int from 0: the vertex of that mesh which corresponds to
            each template vertex; R is the same for all.
    """

    meshes: tuple[Mesh, ...]
    template_to_shape: tuple[np.ndarray, ...]

    def __post_init__(self) -> None:
        for mesh, vertices in zip(self.meshes, self.template_to_shape, strict=True):
            if len(vertices) != len(self.template_to_shape[0]):
                raise StudyError(
                    f"{mesh.case_id} has correspondences for {len(vertices)} template vertices, "
                    f"{self.meshes[0].case_id} for {len(self.template_to_shape[0])}; all shapes "
                    "of a set need the same template. Put each category in a folder of its own, "
                    "under off/ and under corres/."
                )

    def known_pairs(self, shapes: Sequence[int], with_self_pairs: bool = False) -> list[KnownPair]:
        return [
            KnownPair(x, y, self.template_to_shape[x], self.template_to_shape[y])
            for x, y in product(shapes, repeat=2)
            if x != y or with_self_pairs
        ]


@dataclass(frozen=True, eq=False)
class CategorySet:
    """Shapes in categories, each with a template of its own, as DT4D-H.

    Attributes:
        categories: Per mesh, its category.
        template_to_shape: Per mesh (R,) int; R is the same within a category.
        bridges: (first, second) category → (R_first,) int: the second template's vertex for each
            vertex of the first. Between categories only these pairs are known, in this order.
        between: Which pairs to count.
    """

    meshes: tuple[Mesh, ...]
    categories: tuple[str, ...]
    template_to_shape: tuple[np.ndarray, ...]
    bridges: dict[tuple[str, str], np.ndarray]
    between: Between = "all"

    def known_pairs(self, shapes: Sequence[int], with_self_pairs: bool = False) -> list[KnownPair]:
        found = []
        for x, y in product(shapes, repeat=2):
            on_x, on_y = self.template_to_shape[x], self.template_to_shape[y]
            if self.categories[x] == self.categories[y]:
                if self.between != "between categories" and (x != y or with_self_pairs):
                    found.append(KnownPair(x, y, on_x, on_y))
            elif self.between != "within categories":
                bridge = self.bridges.get((self.categories[x], self.categories[y]))
                if bridge is not None:
                    found.append(KnownPair(x, y, on_x, on_y[bridge]))
        return found


@dataclass(frozen=True, eq=False)
class PairwiseSet:
    """Shapes whose correspondences are given pair by pair, as SHREC'19 and TOPKIDS."""

    meshes: tuple[Mesh, ...]
    pairs: tuple[KnownPair, ...]

    def known_pairs(self, shapes: Sequence[int], with_self_pairs: bool = False) -> list[KnownPair]:
        """Those given; a shape's map to itself, where asked for, is the identity."""
        wanted = set(shapes)
        found = [pair for pair in self.pairs if {pair.x, pair.y} <= wanted]
        if with_self_pairs:
            alone = (np.arange(len(self.meshes[shape].vertices)) for shape in shapes)
            found += [
                KnownPair(shape, shape, vertices, vertices)
                for shape, vertices in zip(shapes, alone, strict=True)
            ]
        return found
