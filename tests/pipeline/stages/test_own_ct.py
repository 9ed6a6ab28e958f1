"""The CT of a file's anatomy in the stages: in pictures, in films, and in what policies of X-ray images see."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cathsim import load_phantom
from cathsim.anatomy import import_anatomy
from cathsim.viewing import film
from cathsim.viewing.film import BIPLANE_PX, VIEW_WIDTH_PX
from pipeline.anatomies.anatomy_file import AnatomyFile
from pipeline.jobs.worker import Report
from pipeline.launch import main
from pipeline.stages import load_stage
from pipeline.stages.expert import ExpertSettings, Trial, record_trial
from pipeline.stages.learning.settings import EnnSettings
from pipeline.stages.phantoms import PhantomsSettings
from pipeline.stages.rehearsal.copies import SCAN
from pipeline.stages.rehearsal.episodes import film_scan
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.task import XRAY
from pipeline.stages.unseen.trials import HeldOutSet, run_tests
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task
from tests.cathsim.anatomy.volume.dicom.ct_series import write_segmentation, write_series
from tests.cathsim.anatomy.volume.rasterising import rasterise
from tests.pipeline.anatomies.small_ct import ct_of
from tests.pipeline.composed import composed
from tests.pipeline.stages.rehearsal.small_rehearsal import GENERALIST, job_of
from tests.pipeline.stages.unseen.small_unseen import image_job

pytest.importorskip("pydicom", reason="DICOM files need pydicom")
nibabel = pytest.importorskip("nibabel", reason="the CT is drawn as a NIfTI file")

TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
# Vessels of a segmentation by number: as an arch calls them, and as DICOM does.
VESSELS = {"aorta": "aorta", "bca": "brachiocephalic trunk", "rsa": "right subclavian artery",
           "rcca": "right common carotid artery", "lcca": "left common carotid artery",
           "lsa": "left subclavian artery"}  # fmt: skip


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The settings of an arch and of its CT."""
    folder = tmp_path_factory.mktemp("scan")
    load_phantom("type_1", resolution=2e-3).lumen_mesh.export(folder / "arch.stl")
    own = AnatomyFile.of(str(folder / "arch.stl"))
    return {"file": own.path, "ct": str(ct_of(own.load(), folder / "ct.nii.gz"))}


def test_the_expert_s_film_shows_both_c_arms_in_the_ct(scan: dict[str, Any], tmp_path: Path) -> None:
    settings = ExpertSettings(**scan, phantoms=["x"], targets=["bca"], threads=1, task=Task(max_steps=2))
    record_trial(Trial("arch", "bca", 0), settings, tmp_path, seed=0)
    with Image.open(tmp_path / "arch" / "bca" / "000.gif") as shown:
        assert shown.size in {(2 * BIPLANE_PX, BIPLANE_PX), (2 * BIPLANE_PX + VIEW_WIDTH_PX, BIPLANE_PX)}
        assert np.asarray(shown.convert("L"), float)[:, :BIPLANE_PX].std() > 20


def test_the_rehearsal_films_in_the_ct(scan: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    backgrounds: list[Any] = []

    class Kept(film.Film):
        def __init__(self, stride: int, background: Any) -> None:
            backgrounds.append(background)
            super().__init__(stride)  # the usual fluoroscopy is faster

    monkeypatch.setattr(film, "Film", Kept)
    job = job_of(tmp_path, **scan, targets=["bca"])
    (tmp_path / "after" / SCAN / "0").mkdir(parents=True)
    film_scan(replace(job, policy=GENERALIST, tested="after"), Report())
    assert [background.name for background in backgrounds] == ["ct"]


def test_policies_of_images_are_tested_in_the_ct(scan: dict[str, Any], tmp_path: Path) -> None:
    place = AnatomyFile.of(scan["file"], ct=scan["ct"])
    job = replace(image_job(tmp_path, 1, XRAY), tests=(HeldOutSet("arch", (place, 1), targets=("bca",)),))
    backgrounds: list[Any] = []

    def seen(environment: Any, clutter: float, background: Any) -> Any:
        backgrounds.append(background)
        return environment

    forward = np.array([1.0, 0.0])
    run_tests(job, lambda mode: lambda seed: lambda observation, info: forward, ("tip",), lambda *_: None, seen)
    assert [background and background.name for background in backgrounds] == ["ct", None]
    assert backgrounds[0] is place.background(), "read once"
    bare = job.task.test_environment(place, "bca", "default", ("goal_image",))
    images = [
        job.seen(bare, background=one).reset(seed=0)[0]["image"].astype(float) for one in (place.background(), None)
    ]
    assert np.abs(images[0] - images[1]).mean() > 10


@pytest.mark.parametrize(
    ("settings", "values", "message"),
    [
        (ExpertSettings, {"ct": "none.nii.gz"}, "ct=none.nii.gz is no file"),
        (ExpertSettings, {"file": None}, "ct belongs to a file"),
        (EnnSettings, {}, "ct is shown by the stages phantoms"),
        (ExpertSettings, {"film": False}, "ct needs stage.film"),
        (UnseenSettings, {"xray": False}, "ct needs stage.xray"),
        (PhantomsSettings, {"picture": False}, "ct needs stage.picture"),
    ],
)
def test_a_ct_not_shown_is_refused(scan: dict[str, Any], settings: type, values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=f"^phantom.{message}"):
        settings(**scan | values)


def test_results_depend_on_the_ct_and_that_of_somebody_else_is_refused(scan: dict[str, Any], tmp_path: Path) -> None:
    with_ct = ExpertSettings(**scan, phantoms=["x"], targets=["bca"])
    copy = tmp_path / "copy.nii.gz"
    copy.write_bytes(Path(scan["ct"]).read_bytes())
    assert replace(with_ct, ct=str(copy)).ct_sha256 == with_ct.ct_sha256
    copy.write_bytes(b"another")
    assert replace(with_ct, ct=str(copy)).ct_sha256 != with_ct.ct_sha256
    own = nibabel.load(scan["ct"])
    away = own.affine.copy()
    away[:3, 3] += 400.0  # mm
    nibabel.save(nibabel.Nifti1Image(np.asarray(own.dataobj), away), tmp_path / "other.nii.gz")
    given = (f"phantom.file='{scan['file']}'", f"phantom.ct='{tmp_path / 'other.nii.gz'}'")
    settings = composed("stage=expert", "budget=smoke", *given, "target=bca").stage
    with pytest.raises(ConfigurationError, match=r"other\.nii\.gz"):
        load_stage("expert").prepare(settings)


def test_a_segmentation_and_its_series_are_built_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The segmentation lies 5 mm aside of the series that it was drawn on."""
    monkeypatch.setenv("CATHSIM_CACHE", str(tmp_path / "cache"))
    resolutions: list[float] = []

    def imported(*arguments: Any, resolution: float, **named: Any) -> Any:
        resolutions.append(resolution)
        return import_anatomy(*arguments, resolution=resolution, **named)

    monkeypatch.setattr("cathsim.anatomy.import_anatomy", imported)
    numbers = {name: number for number, name in enumerate(VESSELS, 1)}
    labels, affine = rasterise(load_phantom("type_1", resolution=2e-3), spacing=(1.5e-3, 1.5e-3, 2.5e-3), ids=numbers)
    write_segmentation(tmp_path / "vessels.dcm", labels, TO_LPS @ affine, dict(enumerate(VESSELS.values(), 1)))
    image = nibabel.load(ct_of(AnatomyFile.of(str(tmp_path / "vessels.dcm")).load(2e-3), tmp_path / "ct.nii.gz"))
    affine = TO_LPS @ image.affine
    affine[0, 3] += 5.0
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    values = np.asarray(image.dataobj, float)
    write_series(tmp_path / "the CT", values, affine[:3, :3] / spacing, spacing=spacing, origin=affine[:3, 3])

    given = [f"phantom.file='{tmp_path / 'vessels.dcm'}'", f"phantom.ct='{tmp_path / 'the CT'}'"]
    assert main(["stage=phantoms", "stage.resolution_mm=2.0", *given, f"runs_dir={tmp_path}/runs"]) == 0
    assert set(resolutions) == {2e-3}, "the CT is that of the phantom as it was imported"
    folder = tmp_path / "runs" / "desk" / "phantoms" / "vessels"
    assert set(json.loads((folder / "targets.json").read_text())["targets"]) >= {"bca", "lcca", "lsa", "rsa", "rcca"}
    assert "vessels/radiograph.png" in (folder.parent / "figures.json").read_text()
    picture = np.asarray(Image.open(folder / "radiograph.png"), float)
    assert picture.shape == (512, 1024)
    assert picture.std() > 20, "a body and vessels full of contrast medium"
    account = json.loads((folder / "import.json").read_text())
    assert account["volumes_ml"]["aorta"][0] == pytest.approx(account["volumes_ml"]["aorta"][1], rel=0.03)
    (note,) = (note for note in account["notes"] if "5 mm apart" in note)
    assert note in capfd.readouterr().out
