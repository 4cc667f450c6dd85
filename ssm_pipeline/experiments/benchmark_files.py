"""What a matching benchmark keeps in its folder, so that stopping costs only what was under way.

Every key holds a digest of the code that computes the result: changed code is never answered by an
old result.
"""

from __future__ import annotations

import datetime
import io
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.engine.code_digest import code_digest
from ssm_pipeline.engine.keys import key_of, key_of_arrays
from ssm_pipeline.records import CaseError, Mesh, ShapePath, SpectralBasis
from ssm_pipeline.spectral.settings import SpectralSettings

BASIS_CODE = "ssm_pipeline.spectral.basis"
COARSE_CODE = "ssm_pipeline.meshing.decimation"
GEODESICS_CODE = "ssm_pipeline.geometry.geodesics"
_CACHES = ("bases", "geodesics", "maps", "paths", "matchers")


@dataclass(frozen=True)
class BenchmarkFiles:
    """Bases, geodesic distances, maps and paths in `folder`, each computed when first needed."""

    folder: Path
    spectral: SpectralSettings

    def forget(self) -> None:
        """Delete everything that could be reused. Tables of results stay."""
        for name in _CACHES:
            shutil.rmtree(self.folder / name, ignore_errors=True)

    def basis(self, mesh: Mesh) -> SpectralBasis:
        from ssm_pipeline.spectral.basis import spectral_basis

        path = self.folder / "bases" / self._name(mesh, self.spectral, code_digest(BASIS_CODE))
        if not path.exists():
            storage.save(spectral_basis(mesh, self.spectral), path)
        return storage.load(SpectralBasis, path)

    def training_basis(self, mesh: Mesh, faces: int) -> SpectralBasis:
        """Of the mesh with at most `faces` triangles, which is quicker to train on.

        A mesh that can't be made coarser, since it is no closed manifold, is taken as it is.
        """
        from ssm_pipeline.meshing.decimation import decimate

        path = (
            self.folder
            / "bases"
            / self._name(mesh, self.spectral, faces, code_digest(BASIS_CODE, COARSE_CODE))
        )
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

        key = key_of(key_of_mesh(mesh), code_digest(GEODESICS_CODE))
        path = self.folder / "geodesics" / f"{key}.npy"
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

    def _name(self, mesh: Mesh, *parts: object) -> str:
        return f"{key_of(key_of_mesh(mesh), *parts)}.npz"

    def map_path(self, x: Mesh, y: Mesh, key: str) -> Path:
        return self.folder / "maps" / key / f"{key_of(key_of_mesh(x), key_of_mesh(y))}.npy"


def dates_of(paths: Iterable[Path]) -> str:
    """The day on which files were written, or the first and the last of several days."""
    days = sorted(datetime.date.fromtimestamp(path.stat().st_mtime).isoformat() for path in paths)
    return days[0] if days[0] == days[-1] else f"{days[0]} to {days[-1]}"


def key_of_mesh(mesh: Mesh) -> str:
    """Hash of a mesh's shape; its name does not count."""
    return key_of_arrays(mesh.vertices, mesh.faces)


def _save_array(array: np.ndarray, path: Path) -> None:
    """By way of memory: NumPy, writing an array by itself, does not say that the disk is full."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    storage.write_bytes(path, buffer.getbuffer())
