"""The trained networks and what made them."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ssm_pipeline.matching.hard_map import nearest_features, projected
from ssm_pipeline.matching.settings import InferenceMap
from ssm_pipeline.matching.shape import Shape, to_shape
from ssm_pipeline.matching.soft_map import soft_maps
from ssm_pipeline.records import DamagedFile, SpectralBasis, StudyError
from ssm_pipeline.storage import write_bytes
from ssm_pipeline.training.networks import Networks
from ssm_pipeline.training.packed_weights import pack, unpack
from ssm_pipeline.training.settings import TrainingSettings


@dataclass(frozen=True)
class Matcher:
    """The trained networks.

    trained_on  the cases they have seen. eigenpairs: of the shapes trained on, which the network's
    inputs rest on; 0 where that is not known.
    """

    networks: Networks
    settings: TrainingSettings
    seed: int
    trained_on: tuple[str, ...]
    eigenpairs: int = 0

    @property
    def device(self) -> torch.device:
        return next(self.networks.parameters()).device

    def shape(self, basis: SpectralBasis) -> Shape:
        """Raises StudyError for a basis of more or fewer eigenpairs than were trained with."""
        found = len(basis.eigenvalues)
        if self.eigenpairs not in (0, found):
            raise StudyError(
                f"{basis.case_id} has {found} eigenpairs; the matcher was trained with "
                f"{self.eigenpairs}. Set spectral.eigenpairs={self.eigenpairs}."
            )
        return to_shape(basis, self.settings.matching, self.device)

    @torch.no_grad()
    def features(self, shape: Shape) -> torch.Tensor:
        """(V, channels), any length."""
        return self.networks.features(shape)

    def hard_map(self, shape_x: Shape, shape_y: Shape, projects: bool = True) -> torch.Tensor:
        """x_to_y (n_x,): nearest features, projected on the eigenbasis if wanted."""
        x_to_y = nearest_features(self.features(shape_x), self.features(shape_y))
        return projected(x_to_y, shape_x, shape_y) if projects else x_to_y

    @torch.no_grad()
    def carried(
        self, shape_x: Shape, shape_y: Shape, kind: InferenceMap | None = None
    ) -> torch.Tensor:
        """Y's coordinates carried to X by the inference map: (n_x, 3), unit area.

        kind  instead of `settings.matching.inference_map`.
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
        """X(t) (T, V, 3), unit area, for a shape and the other's coordinates carried onto it."""
        return self.networks.interpolator(
            shape.vertices, target, times.to(target), shape.neighbours
        )


def save_matcher(matcher: Matcher, path: Path, packed: bool = False) -> None:
    """packed: the weights in eight bits (`packed_weights`), for a file a quarter as large."""
    networks = matcher.networks.state()
    if packed:
        networks = {name: pack(state) for name, state in networks.items()}
    content = {
        "format_version": 2,
        "networks": networks,
        "eigenpairs": matcher.eigenpairs,
        "settings": matcher.settings.model_dump_json(),
        "seed": matcher.seed,
        "trained_on": list(matcher.trained_on),
    }
    save_tensors(content, path)


def load_matcher(path: Path, device: str = "cpu") -> Matcher:
    """Raises DamagedFile for a file that holds no whole matcher."""
    content = load_tensors(path, device)
    try:
        settings = TrainingSettings.model_validate_json(content["settings"])
        seed, trained_on = int(content["seed"]), tuple(content["trained_on"])
        eigenpairs = int(content.get("eigenpairs", 0))
        networks = Networks.new(settings, seed, device)
        networks.load({name: unpack(state) for name, state in content["networks"].items()})
    except (AttributeError, KeyError, TypeError, ValueError, RuntimeError) as error:
        what = f"holds no matcher of this version ({str(error).splitlines()[0]})"
        raise DamagedFile(path, what) from error
    return Matcher(networks.eval(), settings, seed, trained_on, eigenpairs)


def save_tensors(content: dict[str, Any], path: Path) -> None:
    """Whole or not at all; only tensors and plain values, so that it loads without pickle code."""
    buffer = io.BytesIO()  # torch's own writer hides why a disk refuses
    torch.save(content, buffer)
    write_bytes(path, buffer.getbuffer())


def load_tensors(path: Path, device: str = "cpu") -> dict[str, Any]:
    """What `save_tensors` wrote; no pickle code is run. Raises DamagedFile."""
    try:
        with zipfile.ZipFile(path) as file:  # torch itself does not look at the checksums
            if (name := file.testzip()) is not None:
                raise DamagedFile(path, f"is damaged ({name} is not what was written)")
        content = torch.load(path, map_location=device, weights_only=True)
    except FileNotFoundError as error:
        raise DamagedFile(path, "is missing") from error
    except (DamagedFile, PermissionError):
        raise
    except Exception as error:  # damaged bytes can break the decoders anywhere
        what = f"is damaged or no file of tensors ({type(error).__name__})"
        raise DamagedFile(path, what) from error
    if not isinstance(content, dict):
        raise DamagedFile(path, f"holds a {type(content).__name__}, no matcher or checkpoint")
    return content
