"""What a mesh lacks of its mask, in words, with the setting that keeps it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssm_pipeline.meshing.handles import Handle
from ssm_pipeline.meshing.losses import Piece

HANDLE_SHARE = 0.1  # of the organ's length: a shorter loop belongs to noise of the segmentation
_MOST = 3  # handles or pieces named one by one


def lost_texts(pieces: Sequence[Piece], keep_thin_parts: bool) -> list[str]:
    """A warning for the parts of the organ that the mesh lacks; none for no parts."""
    if not pieces:
        return []
    advice = (
        "Lower meshing.smoothing_mm and meshing.voxel_mm"
        if keep_thin_parts
        else "meshing.keep_thin_parts: true keeps thin parts"
    )
    return [f"the mesh lacks {_named([_piece(piece) for piece in pieces])}. {advice}"]


def kept_text(pieces: Sequence[Piece], voxel_mm: float) -> str:
    """A remark on thin parts that the usual blur would have removed.

    >>> kept_text([Piece(0.1, 20, 22, np.array([1.0, 2, 3]), np.zeros((4, 3)))], 0.5)
    'thin parts are kept by a grid of 0.5 mm: a part of 0.1 ml, 22 mm long, at (1, 2, 3) mm'
    """
    return (
        f"thin parts are kept by a grid of {voxel_mm:.2g} mm: "
        f"{_named([_piece(piece) for piece in pieces])}"
    )


def handle_texts(handles: Sequence[Handle], volume_mm3: float) -> tuple[str, ...]:
    """A warning that names each handle of a size worth a look; none for small ones."""
    smallest = HANDLE_SHARE * volume_mm3 ** (1 / 3)
    large = sorted((h for h in handles if h.loop_mm >= smallest), key=lambda h: -h.loop_mm)
    if not large:
        return ()
    named = _named(
        [
            f"{'a hole is filled' if h.is_filled else 'a bridge is cut'} at {_place(h.centre_mm)}, "
            f"{h.loop_mm:.0f} mm around"
            for h in large
        ]
    )
    return (f"the surface has a ring or handle: {named}. meshing.cut_handles: false keeps it",)


def _piece(piece: Piece) -> str:
    return (
        f"a part of {piece.volume_ml:.2g} ml, {piece.length_mm:.0f} mm long, at "
        f"{_place(piece.centre_mm)}"
    )


def _named(texts: list[str]) -> str:
    more = len(texts) - _MOST
    return ", ".join([*texts[:_MOST], *([f"and {more} more"] if more > 0 else [])])


def _place(point: np.ndarray) -> str:
    return "({:.0f}, {:.0f}, {:.0f}) mm".format(*point)
