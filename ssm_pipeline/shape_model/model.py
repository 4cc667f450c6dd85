"""The point distribution model: a mean shape and its modes of variation, immutable."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from jaxtyping import Float, Int, Shaped

from ssm_pipeline import storage
from ssm_pipeline.counting import counted
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.topology import submesh_faces
from ssm_pipeline.records import DamagedFile, require_type

ARRAYS = ("mean", "modes", "variances", "faces", "scores")
LABELS = {"unit": np.array("mm"), "space": np.array("LPS"), "format_version": np.array(1)}


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """A mean shape and its modes of variation: x = mean + Σ_m scores_m √variance_m mode_m.

    All arrays are read-only copies. The names of the methods are scalismo's, except that
    coefficients are called scores where a cohort is meant.

    Attributes:
        mean: `(V, 3)` mm LPS.
        modes: `(M, V, 3)`, orthonormal as vectors of 3V numbers.
        variances: `(M,)` mm², divisor N − 1, descending.
        faces: `(F, 3)` int.
        scores: `(N, M)` the training cases in standard deviations. Empty for a model without cases,
            such as a posterior or a model from a file without them.
        case_ids: The N training cases, or none.

    Raises:
        ValueError: For arrays whose shapes do not fit each other.

    Source: Cootes et al. 1995, "Active shape models: their training and application".

    Examples:
        >>> model = ShapeModel(
        ...     mean=np.zeros((3, 3)), modes=np.eye(9)[:2].reshape(2, 3, 3),
        ...     variances=np.array([9, 4]),
        ...     faces=np.array([[0, 1, 2]]), scores=np.zeros((0, 2)), case_ids=(),
        ... )
        >>> model.reconstruct([1.0])[0]  # one standard deviation along the first mode, in mm
        array([3., 0., 0.])
        >>> model.coefficients(model.reconstruct([1.0, -2.0]))
        array([ 1., -2.])
    """

    mean: Float[np.ndarray, "V 3"]
    modes: Float[np.ndarray, "M V 3"]
    variances: Shaped[np.ndarray, " M"]
    faces: Int[np.ndarray, "F 3"]
    scores: Float[np.ndarray, "N M"]
    case_ids: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.modes.shape[1:] != self.mean.shape or len(self.modes) != len(self.variances):
            raise ValueError(
                f"modes have shape {self.modes.shape} for a mean of shape {self.mean.shape} and "
                f"{len(self.variances)} variances; (M, V, 3), (V, 3) and (M,) are needed"
            )
        if self.scores.shape != (len(self.case_ids), len(self.variances)):
            raise ValueError(
                f"scores have shape {self.scores.shape} for {len(self.case_ids)} cases and "
                f"{len(self.variances)} modes; (N, M) is needed"
            )
        for name in ARRAYS:
            array = np.array(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def mode_count(self) -> int:
        """The number of modes M."""
        return len(self.variances)

    @property
    def standard_deviations(self) -> np.ndarray:
        """`(M,)` mm, the standard deviation of each mode."""
        result: np.ndarray = np.sqrt(self.variances)
        return result

    @property
    def compactness(self) -> np.ndarray:
        """`(M,)` the share of the total variance in the first m modes (Davies 2002)."""
        result: np.ndarray = np.cumsum(self.variances) / self.variances.sum()
        return result

    @property
    def vertex_covariances(self) -> np.ndarray:
        """`(V, 3, 3)` mm², the covariance of each vertex over the model's shapes."""
        result: np.ndarray = np.einsum("m,mvd,mve->vde", self.variances, self.modes, self.modes)
        return result

    def modes_for(self, share: float) -> int:
        """The smallest number of modes that holds a share of the variance.

        Args:
            share: The share, 0 … 1.

        Returns:
            The number of modes.

        Raises:
            ValueError: For a share outside 0 … 1.
        """
        if not 0 <= share <= 1:
            raise ValueError(f"share is {share}; 0 … 1 is needed, as 0.9 for 90 %")
        return int(np.searchsorted(self.compactness, share - 1e-12) + 1)

    def reconstruct(self, scores: npt.ArrayLike) -> np.ndarray:
        """Shapes from scores.

        Args:
            scores: `(…, m)` standard deviations, m ≤ M. The other scores are 0.

        Returns:
            `(…, V, 3)` mm.

        Raises:
            ValueError: For more scores than modes.
        """
        scores = np.asarray(scores, dtype=np.float64)
        count = scores.shape[-1]
        if count > self.mode_count:
            raise ValueError(
                f"{counted(count, 'score')} given; the model has {counted(self.mode_count, 'mode')}"
            )
        weights = scores * self.standard_deviations[:count]
        return self.mean + np.tensordot(weights, self.modes[:count], axes=1)

    instance = reconstruct  # scalismo's name

    def coefficients(self, points: np.ndarray) -> np.ndarray:
        """Scores of corresponding, aligned points. To fit a surface, use `ssm_pipeline.fit`.

        Args:
            points: `(…, V, 3)` mm, in correspondence with the mean and in its frame.

        Returns:
            `(…, M)` standard deviations; for a shape that no scores give, those of the nearest.

        Raises:
            ValueError: For another number of points.
        """
        flat = (self._corresponding(points) - self.mean).reshape(*np.shape(points)[:-2], -1)
        result: np.ndarray = (
            flat @ self.modes.reshape(self.mode_count, -1).T / self.standard_deviations
        )
        return result

    def project(self, points: np.ndarray) -> np.ndarray:
        """The nearest shape that the model can take.

        Args:
            points: `(…, V, 3)` mm, in correspondence with the mean and in its frame.

        Returns:
            `(…, V, 3)` mm.
        """
        return self.reconstruct(self.coefficients(points))

    def log_pdf(self, scores: np.ndarray) -> np.ndarray:
        """The log density of scores, which are standard normal.

        Args:
            scores: `(…, M)` standard deviations.

        Returns:
            `(…,)`. Its differences compare two shapes; one value by itself means little.

        Raises:
            ValueError: For another number of scores.
        """
        scores = np.asarray(scores, dtype=np.float64)
        if scores.shape[-1] != self.mode_count:
            raise ValueError(f"{scores.shape[-1]} scores given; the model has {self.mode_count}")
        result: np.ndarray = -0.5 * ((scores**2).sum(axis=-1) + self.mode_count * np.log(2 * np.pi))
        return result

    def sample(self, count: int, generator: np.random.Generator) -> np.ndarray:
        """Independent draws from the model's normal distribution.

        Args:
            count: The number of shapes.
            generator: The source of the draws.

        Returns:
            `(count, V, 3)` mm.
        """
        return self.reconstruct(generator.standard_normal((count, self.mode_count)))

    def truncate(self, mode_count: int) -> ShapeModel:
        """The model with its first modes only.

        Args:
            mode_count: 1 … M.

        Returns:
            The smaller model.

        Raises:
            ValueError: For a number outside 1 … M.
        """
        if not 1 <= mode_count <= self.mode_count:
            raise ValueError(f"{mode_count} modes requested; the model has {self.mode_count}")
        return dataclasses.replace(
            self,
            modes=self.modes[:mode_count],
            variances=self.variances[:mode_count],
            scores=self.scores[:, :mode_count],
        )

    def marginal(self, vertices: np.ndarray) -> ShapeModel:
        """The model of some vertices.

        Its covariance is that part of the whole model's covariance. Its modes are orthonormal on
        these vertices, so they and the scores differ from those of the whole model.

        Args:
            vertices: `(K,)` int, in the order of the result.

        Returns:
            The model of K vertices, with the faces whose three corners are kept.
        """
        spread = (self.standard_deviations[:, None, None] * self.modes)[:, vertices]
        U, singular, Vt = _svd_of_rows(spread.reshape(self.mode_count, -1))
        return ShapeModel(
            mean=self.mean[vertices],
            modes=Vt.reshape(-1, len(vertices), 3),
            variances=singular**2,
            faces=submesh_faces(self.faces, vertices),
            scores=self.scores @ U,
            case_ids=self.case_ids,
        )

    def posterior(self, vertices: np.ndarray, points: np.ndarray, noise_mm: float) -> ShapeModel:
        """The model of the shapes that have some vertices near observed points.

        Args:
            vertices: `(K,)` int.
            points: `(K, 3)` mm in the model's frame, the observed points.
            noise_mm: Standard deviation of each coordinate of each point, independent.

        Returns:
            A model whose mean is the most probable shape, and whose `vertex_covariances` say what
            is still uncertain.

        Raises:
            ValueError: For noise_mm ≤ 0, or another number of points than vertices.

        Source: Albrecht et al. 2013, "Posterior shape models".
        """
        points = np.asarray(points, dtype=np.float64)
        if points.shape != (len(vertices), 3):
            raise ValueError(f"points have shape {points.shape} for {len(vertices)} vertices")
        if not noise_mm > 0:
            raise ValueError(f"noise_mm is {noise_mm}; it must be above 0")
        spread = (self.standard_deviations[:, None, None] * self.modes)[:, vertices]
        Q = spread.reshape(self.mode_count, -1)  # (M, 3K): mm moved per standard deviation
        precision = np.eye(self.mode_count) + Q @ Q.T / noise_mm**2
        offset = (points - self.mean[vertices]).ravel()
        expected = np.linalg.solve(precision, Q @ offset) / noise_mm**2
        return self.conditioned(expected, np.linalg.inv(precision))

    def conditioned(self, scores: np.ndarray, covariance: np.ndarray) -> ShapeModel:
        """The model whose scores have another mean and covariance, as after an observation.

        Args:
            scores: `(M,)` the mean, in standard deviations of this model.
            covariance: `(M, M)`, in the same unit.

        Returns:
            The conditional model, without cases.
        """
        variances, axes = np.linalg.eigh(
            self.standard_deviations[:, None] * covariance * self.standard_deviations
        )
        order = np.argsort(variances)[::-1]
        return ShapeModel(
            mean=self.reconstruct(scores),
            modes=np.tensordot(axes[:, order].T, self.modes, axes=1),
            variances=np.maximum(variances[order], 0),
            faces=self.faces,
            scores=np.zeros((0, self.mode_count)),
            case_ids=(),
        )

    def save(self, path: str | Path) -> None:
        """Write the model to an `.npz`, which `load_model` and any NumPy read.

        It holds mean (V, 3) mm, modes (M, V, 3), variances (M,) mm², faces (F, 3), scores (N, M) in
        standard deviations, case_ids (N,), unit, space and format_version. Nothing is pickled.

        Args:
            path: The file, such as `liver.npz`.
        """
        arrays = {name: getattr(self, name) for name in ARRAYS}
        arrays |= {"case_ids": np.array(self.case_ids, dtype=np.str_), **LABELS}
        storage.save_arrays(arrays, Path(path))

    def transform(self, frame: Similarity) -> ShapeModel:
        """The same model in another frame.

        Args:
            frame: Maps this model's frame to the other. A scale scales the standard deviations.

        Returns:
            The model in the other frame.
        """
        return dataclasses.replace(
            self,
            mean=frame.apply(self.mean),
            modes=self.modes @ frame.rotation.T,
            variances=self.variances * frame.scale**2,
        )

    def _corresponding(self, points: np.ndarray) -> np.ndarray:
        points = np.asarray(points, dtype=np.float64)
        if points.shape[-2:] != self.mean.shape:
            raise ValueError(
                f"points have shape {points.shape}; (…, {len(self.mean)}, 3) is needed, in "
                "correspondence with the model's mean"
            )
        return points


def load_model(path: str | Path) -> ShapeModel:
    """Read a model that `ShapeModel.save`, a run or `workflow export --format npz` wrote.

    Args:
        path: The file, such as `runs/luna16/shape_model/model.npz`.

    Returns:
        The model, in mm LPS.

    Raises:
        TypeError: For anything but one path.
        DamagedFile: For a file that is missing, damaged, or no model in millimetres LPS.

    Examples:
        >>> model = ShapeModel(
        ...     mean=np.zeros((3, 3)), modes=np.eye(9)[:2].reshape(2, 3, 3),
        ...     variances=np.array([9, 4]),
        ...     faces=np.array([[0, 1, 2]]), scores=np.zeros((1, 2)), case_ids=("liver_7",),
        ... )
        >>> model.save("liver.npz")
        >>> load_model("liver.npz").standard_deviations
        array([3., 2.])
    """
    require_type(path, (str, Path), "path")
    arrays = storage.load_arrays(Path(path))
    missing = [name for name in (*ARRAYS, "case_ids", *LABELS) if name not in arrays]
    if missing:
        raise DamagedFile(Path(path), f"is no shape model: it holds no {missing[0]}")
    for name, needed in LABELS.items():
        if arrays[name] != needed:
            what = f"holds a shape model of {name} {arrays[name]}; {needed} is needed"
            raise DamagedFile(Path(path), what)
    with storage.damage_named(Path(path)):  # arrays whose shapes do not fit each other
        case_ids = tuple(str(case_id) for case_id in arrays["case_ids"])
        return ShapeModel(**{name: arrays[name] for name in ARRAYS}, case_ids=case_ids)


def _svd_of_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """U, S, Vt of a matrix, without the singular values that are round-off."""
    U, singular, Vt = np.linalg.svd(rows, full_matrices=False)
    kept = singular > singular[0] * 1e-10
    return U[:, kept], singular[kept], Vt[kept]
