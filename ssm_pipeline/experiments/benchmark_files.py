"""What a matching benchmark keeps in its folder, so that stopping costs only what was under way."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.engine.keys import key_of, key_of_arrays
from ssm_pipeline.records import CaseError, Mesh, ShapePath, SpectralBasis
from ssm_pipeline.spectral.settings import SpectralSettings


@dataclass(frozen=True)
class BenchmarkFiles:
    """Bases, geodesic distances, maps and paths in `folder`, each made when first asked for."""

    folder: Path
    spectral: SpectralSettings

    def basis(self, mesh: Mesh) -> SpectralBasis:
        from ssm_pipeline.spectral.basis import spectral_basis

        path = self.folder / "bases" / f"{key_of(key_of_mesh(mesh), self.spectral)}.npz"
        if not path.exists():
            storage.save(spectral_basis(mesh, self.spectral), path)
        return storage.load(SpectralBasis, path)

    def training_basis(self, mesh: Mesh, faces: int) -> SpectralBasis:
        """Of the mesh with at most `faces` triangles, which is quicker to train on.

        A mesh that can't be made coarser, since it is no closed manifold, is taken as it is.
        """
        from ssm_pipeline.meshing.decimation import decimate

        path = self.folder / "bases" / f"{key_of(key_of_mesh(mesh), self.spectral, faces)}.npz"
        if not path.exists():
            try:
                coarse = decimate(mesh, faces)
            except CaseError:
                coarse = mesh
            storage.save(self.basis(coarse), path)
        return storage.load(SpectralBasis, path)

    def geodesics(self, mesh: Mesh) -> np.ndarray:
        """(V, V) float32, mm; straight across the gaps of a surface in pieces."""
        from ssm_pipeline.geometry.geodesics import geodesic_matrix

        path = self.folder / "geodesics" / f"{key_of(key_of_mesh(mesh))}.npy"
        if not path.exists():
            matrix = geodesic_matrix(mesh.vertices, mesh.faces, across_gaps=True)
            _save_array(matrix, path)
        return np.asarray(np.load(path))

    def map(self, x: Mesh, y: Mesh, key: str, make: Callable[[], np.ndarray]) -> np.ndarray:
        """y_to_x (V_y,), of the method that `key` stands for."""
        path = self.map_path(x, y, key)
        if not path.exists():
            y_to_x = make()
            _save_array(y_to_x, path)
        return np.asarray(np.load(path))

    def path(self, x: Mesh, y: Mesh, key: str, make: Callable[[], ShapePath]) -> ShapePath:
        """The interpolation y → x, of the matcher that `key` stands for."""
        name = f"{key_of(key_of_mesh(x), key_of_mesh(y))}.npz"
        path = self.folder / "paths" / key / name
        if not path.exists():
            storage.save(make(), path)
        return storage.load(ShapePath, path)

    def map_path(self, x: Mesh, y: Mesh, key: str) -> Path:
        return self.folder / "maps" / key / f"{key_of(key_of_mesh(x), key_of_mesh(y))}.npy"


def key_of_mesh(mesh: Mesh) -> str:
    """Hash of a mesh's shape; its name does not count."""
    return key_of_arrays(mesh.vertices, mesh.faces)


def _save_array(array: np.ndarray, path: Path) -> None:
    """By way of memory: NumPy, writing an array by itself, does not say that the disk is full."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    storage.write_bytes(path, buffer.getbuffer())
