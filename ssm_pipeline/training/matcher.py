"""The trained networks, the inputs they read, and what they were trained on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch

from ssm_pipeline.matching.hard_map import nearest_features, projected
from ssm_pipeline.matching.settings import InferenceMap
from ssm_pipeline.matching.shape import Shape, to_shape
from ssm_pipeline.matching.soft_map import soft_maps
from ssm_pipeline.records import DamagedFile, SpectralBasis, StudyError, require_type
from ssm_pipeline.training.input_probe import probe_inputs, refuse_other_inputs
from ssm_pipeline.training.networks import Networks
from ssm_pipeline.training.packed_weights import pack, unpack
from ssm_pipeline.training.settings import TrainingSettings
from ssm_pipeline.training.tensor_files import load_tensors, save_tensors


@dataclass(frozen=True)
class Matcher:
    """The trained networks. `train` makes one; `save` and `load_matcher` keep it in a file.

    Attributes:
        networks: The feature network and the interpolator.
        settings: The settings of the training. They decide what the networks read.
        seed: The seed of the first weights and of the order of the pairs.
        trained_on: The case ids that the networks have seen, those of the starting weights first.
        eigenpairs: The number of eigenpairs of the shapes trained on. The network's inputs depend
            on it.
    """

    networks: Networks
    settings: TrainingSettings
    seed: int
    trained_on: tuple[str, ...]
    eigenpairs: int

    @property
    def device(self) -> torch.device:
        """The device that holds the weights."""
        return next(self.networks.parameters()).device

    def shape(self, basis: SpectralBasis) -> Shape:
        """Put a spectral basis on the matcher's device, with the network's inputs.

        Args:
            basis: A basis with as many eigenpairs as were trained with.

        Returns:
            The shape as the networks read it.

        Raises:
            StudyError: For a basis with more or fewer eigenpairs.
        """
        found = len(basis.eigenvalues)
        if found != self.eigenpairs:
            raise StudyError(
                f"{basis.case_id} has {found} eigenpairs; the matcher was trained with "
                f"{self.eigenpairs}. Set spectral.eigenpairs={self.eigenpairs}."
            )
        return to_shape(basis, self.settings.matching, self.device)

    @torch.no_grad()
    def features(self, shape: Shape) -> torch.Tensor:
        """The features of a shape's vertices.

        Args:
            shape: A shape of `Matcher.shape`.

        Returns:
            `(V, channels)`, of any length.
        """
        result: torch.Tensor = self.networks.features(shape)
        return result

    def hard_map(self, shape_x: Shape, shape_y: Shape, projects: bool = True) -> torch.Tensor:
        """The vertex of Y that corresponds to each vertex of X, by the nearest features.

        Args:
            shape_x: The shape X.
            shape_y: The shape Y.
            projects: Whether the map is projected on the eigenbasis.

        Returns:
            x_to_y, `(n_x,)` int.
        """
        x_to_y = nearest_features(self.features(shape_x), self.features(shape_y))
        return projected(x_to_y, shape_x, shape_y) if projects else x_to_y

    @torch.no_grad()
    def carried(
        self, shape_x: Shape, shape_y: Shape, kind: InferenceMap | None = None
    ) -> torch.Tensor:
        """Map Y's coordinates to X by the inference map.

        Args:
            shape_x: The shape X.
            shape_y: The shape Y.
            kind: The map. None: `settings.matching.inference_map`.

        Returns:
            `(n_x, 3)`, unit area.
        """
        kind = kind or self.settings.matching.inference_map
        if kind != "soft":
            return shape_y.vertices[self.hard_map(shape_x, shape_y, kind == "projected")]
        matching = self.settings.matching
        on_x, _ = soft_maps(
            self.features(shape_x),
            self.features(shape_y),
            shape_x.vertices,
            shape_y.vertices,
            matching.temperature,
            matching.block_rows,
        )
        return on_x

    @torch.no_grad()
    def poses(self, shape: Shape, target: torch.Tensor, times: torch.Tensor) -> torch.Tensor:
        """The poses X(t) between a shape and the mapped coordinates of another.

        Args:
            shape: The shape X.
            target: `(V, 3)`, the other shape's coordinates mapped to X, unit area.
            times: `(T,)`, in [0, 1].

        Returns:
            `(T, V, 3)`, unit area.
        """
        result: torch.Tensor = self.networks.interpolator(
            shape.vertices, target, times.to(target), shape.neighbours
        )
        return result

    def save(self, path: str | Path, packed: bool = False) -> None:
        """Write the matcher to a file, which `load_matcher` reads.

        The file holds the weights, the settings, the case ids, and the inputs that the networks
        read from a small known shape. It contains no pickled code.

        Args:
            path: The file, such as `liver.pt`.
            packed: Whether the weights are stored in eight bits. The file is then a quarter as
                large, and the features change slightly.
        """
        require_type(path, (str, Path), "path")
        networks = self.networks.state()
        if packed:
            networks = {name: pack(state) for name, state in networks.items()}
        content = {
            "format_version": FORMAT_VERSION,
            "networks": networks,
            "eigenpairs": self.eigenpairs,
            "settings": self.settings.model_dump_json(),
            "seed": self.seed,
            "trained_on": list(self.trained_on),
            "probe": probe_inputs(self.settings.matching),
        }
        save_tensors(content, Path(path))


FORMAT_VERSION = 3


def load_matcher(path: str | Path, device: str = "cpu") -> Matcher:
    """Read a matcher that `Matcher.save` or a run wrote.

    Args:
        path: The file, such as `runs/luna16/training/matcher.pt`.
        device: Where the weights are put: "cpu" or "cuda".

    Returns:
        The matcher, ready to match.

    Raises:
        DamagedFile: For a file that is missing, damaged, or does not hold a complete matcher.
        StudyError: For a matcher that was trained on other inputs than this version computes.

    Examples:
        >>> import trimesh
        >>> from ssm_pipeline import Mesh, train
        >>> ball = trimesh.creation.icosphere(3)
        >>> meshes = [Mesh(ball.vertices * [30, 40, z], ball.faces, f"case_{z}") for z in (45, 55)]
        >>> matcher = train(meshes, steps=1, device="cpu")
        >>> matcher.save("liver.pt")
        >>> load_matcher("liver.pt").trained_on
        ('case_45', 'case_55')
    """
    require_type(path, (str, Path), "path")
    path = Path(path)
    content = load_tensors(path, device)
    try:
        if content["format_version"] != FORMAT_VERSION:
            raise ValueError(f"its format is {content['format_version']}, not {FORMAT_VERSION}")
        settings = TrainingSettings.model_validate_json(content["settings"])
        seed, trained_on = int(content["seed"]), tuple(content["trained_on"])
        eigenpairs, probe = int(content["eigenpairs"]), content["probe"].cpu()
        networks = Networks.new(settings, seed, device)
        networks.load({name: unpack(state) for name, state in content["networks"].items()})
    except (AttributeError, KeyError, TypeError, ValueError, RuntimeError) as error:
        what = f"holds no matcher of this version ({str(error).splitlines()[0]})"
        raise DamagedFile(path, what) from error
    refuse_other_inputs(path, probe, settings.matching)
    return Matcher(networks.eval(), settings, seed, trained_on, eigenpairs)
