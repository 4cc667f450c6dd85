"""Settings of the S3M baseline."""

from __future__ import annotations

from pydantic import Field

from ssm_pipeline.settings import Settings


class S3MSettings(Settings):
    """The published settings of S3M (Bastian et al. 2023); `tuned` gives the second one reported.

    The published augmentation is in voxels of a thyroid scan (bumps of ±10 and 70 voxels of
    0.12 mm, on lobes of about 50 × 20 × 20 mm); here it is in shares of √area, so that lungs and
    hippocampi are bent as much as those thyroids were.
    """

    eigenfunctions: int = Field(default=20, ge=2)  # the constant one included
    dense_points: int = Field(default=4000, ge=1)  # training draws its samples from these
    points: int = Field(default=2048, ge=2)  # points of a training sample and of the result
    neighbours: int = Field(default=10, ge=1)  # of the kNN graph, on raw coordinates
    feature_size: int = Field(default=352, ge=4, multiple_of=4)  # descriptors a point
    one_size: bool = False  # shapes scaled to the cohort's mean √area for training, else as in mm

    rotated_copies: int = Field(default=1, ge=0)  # a shape, turned about z by a random angle
    bumped_copies: int = Field(default=1, ge=0)  # a shape, with Gaussian bumps
    bumps: int = Field(default=4, ge=1)  # a bumped copy
    bump_height: float = Field(default=0.024, ge=0)  # along the normal, in or out, share of √area
    bump_std: float = Field(default=0.16, gt=0)  # share of √area

    bijectivity: float = Field(default=1.0, ge=0)  # weight
    orthogonality: float = Field(default=1.0, ge=0)  # weight
    laplacian: float = Field(default=1e-3, ge=0)  # weight
    preservation: float = Field(default=100.0, ge=0)  # weight
    preservation_share: float = Field(
        default=0.2, gt=0, le=1
    )  # of the descriptors, drawn at each step

    learning_rate: float = Field(default=1e-4, gt=0)  # AdamW
    epochs: int = Field(default=30, ge=1)  # each: as many pairs as ordered pairs of copies
    pairs_per_step: int = Field(default=64, ge=1)  # the batch, of all ordered pairs in random order
    # Instead: all ordered pairs of so many copies drawn at random. 8 give as many pairs a step for
    # 8 passes of the network, where 64 pairs drawn one by one ask for about 57 (of 66 copies).
    copies_per_step: int | None = Field(default=None, ge=2)
    plateau_factor: float = Field(default=0.1, gt=0, lt=1)  # of the learning rate
    plateau_patience: int = Field(default=20, ge=0)  # epochs
    plateau_threshold: float = Field(default=1e-2, ge=0)  # relative

    # The product manifold filter's Gaussian kernel; a share, if set, replaces the variance.
    kernel_variance_mm2: float = Field(default=1000.0, gt=0)  # mm²
    kernel_std_share: float | None = Field(default=None, gt=0)  # of √area

    def tuned(self) -> S3MSettings:
        """These settings with the filter's kernel in proportion to the organ.

        Its variance is share² times the case's area: the same smoothing for a hippocampus as for a
        lung. The training is untouched, so both rows of a table share one network.
        """
        return self.model_copy(update={"kernel_std_share": 0.1})
