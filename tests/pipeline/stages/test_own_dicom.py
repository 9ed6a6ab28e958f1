"""The phantoms stage on a hospital's files: a CT series, and a DICOM segmentation of its vessels."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cathsim import load_phantom
from pipeline.anatomies.anatomy_file import AnatomyFile
from pipeline.launch import main
from tests.cathsim.anatomy.volume.dicom.ct_series import write_segmentation, write_series
from tests.cathsim.anatomy.volume.rasterising import rasterise
from tests.pipeline.anatomies.small_ct import ct_of

pytest.importorskip("pydicom", reason="DICOM files need pydicom")
nibabel = pytest.importorskip("nibabel", reason="the CT is drawn as a NIfTI file")

TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
NUMBERS = {"aorta": 1, "bca": 2, "rsa": 3, "rcca": 4, "lcca": 5, "lsa": 6}
NAMES = ("aorta", "brachiocephalic trunk", "right subclavian artery", "right common carotid artery",
         "left common carotid artery", "left subclavian artery")  # fmt: skip


@pytest.fixture
def hospital(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """A segmentation, and the series that it was drawn on, 5 mm aside."""
    monkeypatch.setenv("CATHSIM_CACHE", str(tmp_path / "cache"))
    labels, affine = rasterise(load_phantom("type_1", resolution=2e-3), spacing=(1.5e-3, 1.5e-3, 2.5e-3), ids=NUMBERS)
    write_segmentation(tmp_path / "vessels.dcm", labels, TO_LPS @ affine, dict(enumerate(NAMES, 1)))
    phantom = AnatomyFile.of(str(tmp_path / "vessels.dcm")).load(2e-3)
    image = nibabel.load(ct_of(phantom, tmp_path / "ct.nii.gz"))
    affine = TO_LPS @ image.affine
    affine[0, 3] += 5.0
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    values = np.asarray(image.dataobj, float)
    write_series(tmp_path / "the CT", values, affine[:3, :3] / spacing, spacing=spacing, origin=affine[:3, 3])
    return {"file": tmp_path / "vessels.dcm", "ct": tmp_path / "the CT"}


def test_a_segmentation_and_its_series_are_built_and_drawn(
    hospital: dict[str, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    given = [f"phantom.{key}='{path}'" for key, path in hospital.items()]
    assert main(["stage=phantoms", *given, "stage.resolution_mm=2.0", f"runs_dir={tmp_path}/runs"]) == 0
    folder = tmp_path / "runs" / "desk" / "phantoms" / "vessels"
    assert set(json.loads((folder / "targets.json").read_text())["targets"]) >= {"bca", "lcca", "lsa", "rsa", "rcca"}
    assert np.asarray(Image.open(folder / "radiograph.png"), float).std() > 20
    account = json.loads((folder / "import.json").read_text())
    assert account["volumes_ml"]["aorta"][0] == pytest.approx(account["volumes_ml"]["aorta"][1], rel=0.03)
    (note,) = (note for note in account["notes"] if "mm apart" in note)
    assert note.startswith("the CT and the vessels lie 5 mm apart")
    assert f"vessels: note: {note}" in capfd.readouterr().out
