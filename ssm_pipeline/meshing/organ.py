"""What of a mask is the organ: its largest piece, without cavities, and what that leaves out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ssm_pipeline.counting import counted
from ssm_pipeline.records import CaseError, Mask

TOLD_PERCENT = 1.0  # of the volume: less than that left out or filled is noise of segmentation
ANOTHER_ORGAN = 0.3  # a second piece this large beside the first is no crumb


@dataclass(frozen=True)
class Cleaning:
    """What was done to a mask before it was meshed; volumes in mm³.

    Attributes:
        given: Volume as read.
        pieces: How many it fell into (26-neighbours).
        left_out: Of all pieces but the largest.
        second: Of the largest of those.
        filled: Of the cavities that the largest piece encloses.
    """

    given: float
    pieces: int
    left_out: float
    second: float
    filled: float

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader should know, in words; empty where little changed.

        >>> Cleaning(given=2000, pieces=2, left_out=1000, second=1000, filled=0).warnings[0][:48]
        'the mask holds 2 pieces; all but the largest, 50'
        """
        told = []
        largest = self.given - self.left_out
        left_out = 100 * self.left_out / self.given
        if left_out >= TOLD_PERCENT:
            text = (
                f"the mask holds {counted(self.pieces, 'piece')}; all but the largest, "
                f"{left_out:.0f} % of "
                f"its volume ({self.left_out / 1000:.3g} ml), are left out"
            )
            if self.second >= ANOTHER_ORGAN * largest:
                text += (
                    f". The second piece is {100 * self.second / largest:.0f} % as large as the "
                    "first: two organs under one label? Give each its own"
                )
            told.append(text)
        if 100 * self.filled / largest >= TOLD_PERCENT:
            told.append(
                f"cavities of {self.filled / 1000:.3g} ml inside the organ "
                f"({100 * self.filled / largest:.0f} % of it) are filled"
            )
        return tuple(told)


def keep_organ(mask: Mask) -> tuple[Mask, Cleaning]:
    """Crop to the mask, keep its largest piece (26-neighbours) and fill enclosed cavities.

    Raises:
        CaseError: For an empty mask.
    """
    cropped = _crop(mask)
    given, voxel_mm3 = cropped.volume_mm3, float(np.prod(cropped.spacing_mm))
    pieces, count = ndimage.label(cropped.voxels, structure=np.ones((3, 3, 3)))
    left_out = second = 0.0
    if count > 1:
        sizes = np.bincount(pieces.ravel())
        sizes[0] = 0
        second = float(np.sort(sizes)[-2]) * voxel_mm3
        left_out = given - float(sizes.max()) * voxel_mm3
        cropped = _crop(replace(cropped, voxels=pieces == sizes.argmax()))
    del pieces
    kept = cropped.volume_mm3
    # A margin of one voxel joins the outside into one piece; what else is empty is a cavity.
    outside, cavities = ndimage.label(np.pad(~cropped.voxels, 1, constant_values=True))
    if cavities > 1:
        filled = (outside != outside[0, 0, 0])[1:-1, 1:-1, 1:-1]
        cropped = replace(cropped, voxels=filled)
    return cropped, Cleaning(given, count, left_out, second, cropped.volume_mm3 - kept)


def _crop(mask: Mask) -> Mask:
    lows, highs = [], []
    for axis in range(3):
        used = np.flatnonzero(mask.voxels.any(axis=tuple({0, 1, 2} - {axis})))
        if len(used) == 0:
            raise CaseError(mask.case_id, "the mask is empty; an organ is needed. Check its label.")
        lows.append(used[0])
        highs.append(used[-1] + 1)
    voxels = mask.voxels[lows[0] : highs[0], lows[1] : highs[1], lows[2] : highs[2]]
    origin = mask.to_world(np.array(lows[::-1], float))
    # Labels of parts stay with the mask as read: the surface's are looked up there.
    return replace(mask, voxels=np.ascontiguousarray(voxels), origin_mm=origin, labels=None)
