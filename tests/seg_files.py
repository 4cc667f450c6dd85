"""Segmentations as other programs write them: 3D Slicer's by slicerio, DICOM SEG by highdicom."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssm_pipeline.records import Mask


def affine_of(mask: Mask) -> np.ndarray:
    """(4, 4): voxel index x, y, z → mm LPS."""
    affine = np.eye(4)
    affine[:3, :3] = np.asarray(mask.direction) * mask.spacing_mm
    affine[:3, 3] = mask.origin_mm
    return affine


def write_seg_nrrd(path: Path, mask: Mask, segments: dict[str, np.ndarray]) -> Path:
    """Overlapping segments (Z, Y, X) bool in layers of their own, as 3D Slicer keeps them."""
    import slicerio

    stacked = np.stack([voxels.transpose(2, 1, 0) for voxels in segments.values()])
    content = {
        "voxels": stacked.astype(np.uint8) if len(segments) > 1 else stacked[0].astype(np.uint8),
        "ijkToLPS": affine_of(mask),
        "encoding": "gzip",
        "containedRepresentationNames": ["Binary labelmap"],
        "masterRepresentation": "Binary labelmap",
        "referenceImageExtentOffset": [0, 0, 0],
        "segments": [
            {
                "id": f"Segment_{number}",
                "name": name,
                "labelValue": 1,
                "layer": number,
                "color": [1.0, 0.5, 0.2],
                "extent": [0, 1, 0, 1, 0, 1],
            }
            for number, name in enumerate(segments)
        ],
    }
    slicerio.write_segmentation(str(path), content)
    return path


def write_dicom_seg(
    path: Path, mask: Mask, segments: dict[str, np.ndarray], kind: str = "BINARY"
) -> Path:
    """Segments (Z, Y, X) bool, or shares of 0 … 1 for kind FRACTIONAL."""
    import highdicom
    from pydicom.dataset import Dataset, FileMetaDataset
    from pydicom.sr.codedict import codes
    from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

    slices, rows, columns = mask.voxels.shape
    study, series, frame = generate_uid(), generate_uid(), generate_uid()
    sources = []
    for index in range(slices):
        image = Dataset()
        image.file_meta = FileMetaDataset()
        image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        image.SOPClassUID, image.SOPInstanceUID = CTImageStorage, generate_uid()
        image.StudyInstanceUID, image.SeriesInstanceUID = study, series
        image.FrameOfReferenceUID, image.Modality = frame, "CT"
        image.PatientID, image.PatientName = "secret", "Secret^Name"
        image.PatientBirthDate, image.PatientSex = "", ""
        image.StudyDate, image.StudyTime, image.StudyID = "20200101", "000000", ""
        image.AccessionNumber, image.ReferringPhysicianName = "", ""
        image.SeriesNumber, image.InstanceNumber = 1, index + 1
        image.Rows, image.Columns = rows, columns
        image.PixelSpacing = [float(mask.spacing_mm[1]), float(mask.spacing_mm[0])]
        image.SliceThickness = float(mask.spacing_mm[2])
        image.ImageOrientationPatient = [*mask.direction[:, 0], *mask.direction[:, 1]]
        image.ImagePositionPatient = list(mask.to_world(np.array([0.0, 0, index])))
        sources.append(image)
    descriptions = [
        highdicom.seg.SegmentDescription(
            segment_number=number,
            segment_label=name,
            segmented_property_category=codes.SCT.Organ,
            segmented_property_type=codes.SCT.Lung,
            algorithm_type=highdicom.seg.SegmentAlgorithmTypeValues.MANUAL,
        )
        for number, name in enumerate(segments, start=1)
    ]
    stacked = np.stack(list(segments.values()), axis=-1)
    segmentation = highdicom.seg.Segmentation(
        source_images=sources,
        pixel_array=stacked.astype(np.float32 if kind == "FRACTIONAL" else np.uint8),
        segmentation_type=kind,
        segment_descriptions=descriptions,
        series_instance_uid=generate_uid(),
        series_number=2,
        sop_instance_uid=generate_uid(),
        instance_number=1,
        manufacturer="test",
        manufacturer_model_name="test",
        software_versions="1",
        device_serial_number="1",
        series_description="test",
        content_label="TEST",
    )
    segmentation.save_as(path)
    return path
