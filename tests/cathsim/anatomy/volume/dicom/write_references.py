"""Writes the files in `references/` with highdicom 0.28.2 and rt-utils 1.2.7: python write_references.py FOLDER.

The tests read what these programs wrote; they need neither of them.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from ct_series import SHAPE, VESSELS, axes, masks, write_series


def write_segmentations(folder: Path) -> None:
    """Binary, fractional and label maps, over oblique slices."""
    import highdicom as hd
    import pydicom
    from pydicom.sr.codedict import codes

    with tempfile.TemporaryDirectory() as place:
        files = write_series(Path(place), np.zeros(SHAPE), axes())
        images = [pydicom.dcmread(path) for path in files]
    both = np.stack([masks()[number].transpose(2, 1, 0) for number in VESSELS], axis=-1)
    types = {1: codes.SCT.Aorta, 2: hd.sr.CodedConcept("36765005", "SCT", "Subclavian artery")}
    for kind in ("binary", "fractional", "labelmap"):
        described = [
            hd.seg.SegmentDescription(
                segment_number=number,
                segment_label=name if kind == "binary" else f"Segment_{number}",
                segmented_property_category=codes.SCT.AnatomicalStructure,
                segmented_property_type=types[number],
                algorithm_type="MANUAL",
                anatomic_regions=[codes.SCT.Thorax],
            )
            for number, name in VESSELS.items()
        ]
        content = both.astype(np.uint8)
        if kind == "fractional":
            content = np.where(both, 0.75, 0.25).astype(np.float32)
        elif kind == "labelmap":
            content = np.where(both[..., 1], 2, both[..., 0]).astype(np.uint8)
        made = hd.seg.Segmentation(
            source_images=images, pixel_array=content, segmentation_type=kind.upper(), segment_descriptions=described,
            series_instance_uid="1.2.3.7", series_number=7, sop_instance_uid="1.2.3.7.1", instance_number=1,
            manufacturer="None", manufacturer_model_name="None", software_versions="0", device_serial_number="0",
        )  # fmt: skip
        made.save_as(folder / f"highdicom_{kind}.dcm")


def write_contours(folder: Path) -> None:
    """A structure set of contours, over slices in the patient's axes."""
    from rt_utils import RTStructBuilder

    with tempfile.TemporaryDirectory() as place:
        # of square pixels: rt-utils exchanges their sides
        write_series(Path(place), np.zeros(SHAPE), PixelSpacing=[0.8, 0.8])
        made = RTStructBuilder.create_new(dicom_series_path=place)
        for number, name in VESSELS.items():
            made.add_roi(mask=masks()[number].transpose(1, 0, 2), name=name)
        made.save(str(folder / "rt_utils.dcm"))


if __name__ == "__main__":
    write_segmentations(Path(sys.argv[1]))
    write_contours(Path(sys.argv[1]))
