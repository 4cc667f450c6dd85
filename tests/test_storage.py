"""Files are written whole or not at all, and what can't be read back is one kind of error."""

from __future__ import annotations

import errno
import os
import pickle
import stat
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp

from ssm_pipeline import storage
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import DamagedFile, Mesh, Metrics, SpectralBasis, StudyError

TRIANGLE = Mesh(np.eye(3), np.array([[0, 1, 2]]), "007")
SPARSE = sp.csr_matrix(np.diag([1.0, 2.0, 3.0]))
BASIS = SpectralBasis(
    case_id="007",
    vertices=np.eye(3),
    faces=TRIANGLE.faces,
    eigenvalues=np.arange(2.0),
    eigenvectors=np.ones((3, 2)),
    mass=np.ones(3),
    laplacian=SPARSE,
    gradient_x=SPARSE,
    gradient_y=SPARSE,
    frame=Similarity(2.0, np.eye(3), np.arange(3.0)),
)


@pytest.fixture
def written(tmp_path: Path) -> Path:
    storage.save(BASIS, tmp_path / "basis.npz")
    return tmp_path / "basis.npz"


def test_a_record_comes_back_as_it_was(written: Path) -> None:
    back = storage.load(SpectralBasis, written)
    assert back.case_id == "007"
    assert (back.laplacian != BASIS.laplacian).nnz == 0
    np.testing.assert_array_equal(back.frame.translation, BASIS.frame.translation)


def test_a_field_that_was_renamed_is_read_from_older_files(written: Path) -> None:
    arrays = storage.load_arrays(written)
    older = {name.replace("laplacian", "stiffness"): value for name, value in arrays.items()}
    older["header"] = np.array(str(arrays["header"]).replace("laplacian", "stiffness"))
    assert "stiffness.data" in older
    storage.save_arrays(older, written)
    assert (storage.load(SpectralBasis, written).laplacian != BASIS.laplacian).nnz == 0


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_a_record_cut_short_is_named_and_what_to_do_said(written: Path, share: float) -> None:
    whole = written.read_bytes()
    written.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(DamagedFile, match=r"basis\.npz is damaged .* run the study again") as error:
        storage.load(SpectralBasis, written)
    assert error.value.path == written


def test_every_flipped_byte_of_an_array_is_found(written: Path) -> None:
    whole = written.read_bytes()
    start = whole.index(np.arange(2.0).tobytes())
    for position in range(start, start + 16):
        flipped = bytearray(whole)
        flipped[position] ^= 1
        written.write_bytes(flipped)
        with pytest.raises(DamagedFile):
            storage.load(SpectralBasis, written)


def test_a_missing_file_and_one_of_another_kind_are_damaged_files(written: Path) -> None:
    with pytest.raises(DamagedFile, match="is missing"):
        storage.load(Mesh, written.with_name("none.npz"))
    with pytest.raises(DamagedFile, match="holds a SpectralBasis of format 1; a Mesh"):
        storage.load(Mesh, written)


def test_a_sparse_matrix_that_names_missing_columns_is_refused(tmp_path: Path) -> None:
    broken = SPARSE.copy()
    broken.indices = np.array([0, 1, 99], dtype=np.int32)
    storage.save(Similarity.identity(), tmp_path / "frame.npz")
    content = {**BASIS.__dict__, "laplacian": broken}
    storage.save(SpectralBasis(**content), tmp_path / "basis.npz")
    with pytest.raises(DamagedFile):
        storage.load(SpectralBasis, tmp_path / "basis.npz")


def test_a_damaged_file_travels_between_processes(tmp_path: Path) -> None:
    error = pickle.loads(pickle.dumps(DamagedFile(tmp_path / "a", "is missing")))
    assert error.path == tmp_path / "a"
    assert "is missing" in str(error)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b'{"a": 1'])
def test_json_that_is_none_is_a_damaged_file(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "stage.json").write_bytes(content)
    with pytest.raises(DamagedFile, match="not readable as JSON"):
        storage.read_json(tmp_path / "stage.json")


def test_tables_keep_case_ids_as_they_are(tmp_path: Path) -> None:
    ids = ["007", "NA", "nan", "None", "1e5"]
    table = pd.DataFrame({"case_id": ids, "volume_ml": [1.0, np.nan, 3, 4, 5]})
    storage.save_tables(Metrics({"quality": table}), tmp_path)
    pd.testing.assert_frame_equal(storage.load_tables(tmp_path).tables["quality"], table)


@pytest.mark.parametrize("content", [b"", b'a,b\n"1,2\n3', b"\xff\xfe\x00"])
def test_a_table_that_is_none_is_a_damaged_file(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "quality.csv").write_bytes(content)
    with pytest.raises(DamagedFile, match=r"quality\.csv"):
        storage.load_tables(tmp_path)


def test_the_content_is_on_the_disk_before_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    happened: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def noted_fsync(handle: int) -> None:
        happened.append("folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file")
        fsync(handle)

    def noted_replace(self: Path, target: Path) -> Path:
        happened.append("name")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(Path, "replace", noted_replace)
    storage.write_text(tmp_path / "a.txt", "a")
    assert happened == ["file", "name", "folder"]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EACCES])
def test_a_disk_that_refuses_is_one_message_and_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    storage.write_text(tmp_path / "a.txt", "old")

    def refuse(handle: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(StudyError, match=rf"a\.txt can't be written: {os.strerror(code)}"):
        storage.write_text(tmp_path / "a.txt", "new")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


def test_a_fault_of_the_program_is_not_taken_for_the_disk(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        with storage.written_whole(tmp_path / "a.txt"):
            raise ZeroDivisionError
    assert not list(tmp_path.iterdir())


def test_ids_of_digits_stay_text(tmp_path: Path) -> None:
    columns = ("case_id", "patient", "left_out", "nearest_by_surface", "nearest_by_chamfer")
    ids = ("01", "1", "007", "NA")
    storage.write_table(pd.DataFrame({name: ids for name in columns}), tmp_path / "cohort.csv")
    read = storage.read_table(tmp_path / "cohort.csv")
    for name in columns:
        assert read[name].tolist() == list(ids)
