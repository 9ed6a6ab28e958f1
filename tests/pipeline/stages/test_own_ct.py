"""The CT of a file's anatomy in the stages: in pictures, in films, and in what policies of X-ray images see."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cathsim import load_phantom
from cathsim.viewing import film
from cathsim.viewing.film import ROOM_PX, VIEW_WIDTH_PX
from pipeline.anatomies.anatomy_file import AnatomyFile
from pipeline.jobs.worker import Report
from pipeline.launch import main
from pipeline.stages import load_stage
from pipeline.stages.expert import ExpertSettings, Trial, record_trial
from pipeline.stages.learning.settings import EnnSettings
from pipeline.stages.phantoms import PhantomsSettings, run_phantoms
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
from tests.pipeline.stages.small_expert import context
from tests.pipeline.stages.unseen.small_unseen import image_job

WITH_3D = 2 * ROOM_PX + VIEW_WIDTH_PX


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The settings of an arch and of its CT."""
    folder = tmp_path_factory.mktemp("scan")
    load_phantom("type_1", resolution=2e-3).lumen_mesh.export(folder / "arch.stl")
    own = AnatomyFile.of(str(folder / "arch.stl"))
    return {"file": own.path, "ct": str(ct_of(own.load(), folder / "ct.nii.gz"))}


def test_the_stage_phantoms_draws_the_contrast_run_in_the_ct(scan: dict[str, Any], tmp_path: Path) -> None:
    stage = tmp_path / "phantoms"
    run_phantoms(PhantomsSettings(**scan), context(tmp_path, "phantoms")).write(stage)
    shown = json.loads((stage / "figures.json").read_text())
    assert "arch/radiograph.png" in json.dumps(shown)
    picture = np.asarray(Image.open(stage / "arch" / "radiograph.png"), float)
    assert picture.shape == (512, 1024)
    assert picture.std() > 20, "a body and vessels full of contrast medium"


def test_the_expert_s_film_shows_both_c_arms_in_the_ct(scan: dict[str, Any], tmp_path: Path) -> None:
    settings = ExpertSettings(**scan, phantoms=["x"], targets=["bca"], threads=1, task=Task(max_steps=2))
    record_trial(Trial("arch", "bca", 0), settings, tmp_path, seed=0)
    with Image.open(tmp_path / "arch" / "bca" / "000.gif") as shown:
        assert shown.size in {(2 * ROOM_PX, ROOM_PX), (WITH_3D, ROOM_PX)}
        assert np.asarray(shown.convert("L"), float)[:, :ROOM_PX].std() > 20


def test_the_rehearsal_s_film_is_taken_in_the_ct(
    scan: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rooms: list[Any] = []

    class Kept(film.Film):
        def __init__(self, stride: int, room: Any) -> None:
            rooms.append(room)
            super().__init__(stride)  # the usual fluoroscopy is faster

    monkeypatch.setattr(film, "Film", Kept)
    job = job_of(tmp_path, **scan, targets=["bca"])
    (tmp_path / "after" / SCAN / "0").mkdir(parents=True)
    film_scan(replace(job, policy=GENERALIST, tested="after"), Report())
    assert [room.name for room in rooms] == ["ct"]


def test_policies_of_images_are_tested_in_the_ct(scan: dict[str, Any], tmp_path: Path) -> None:
    place = AnatomyFile.of(scan["file"], ct=scan["ct"])
    job = replace(image_job(tmp_path, 1, XRAY), tests=(HeldOutSet("arch", (place, 1), targets=("bca",)),))
    rooms: list[Any] = []

    def seen(environment: Any, clutter: float, room: Any) -> Any:
        rooms.append(room)
        return environment

    forward = np.array([1.0, 0.0])
    run_tests(job, lambda mode: lambda seed: lambda observation, info: forward, ("tip",), lambda *_: None, seen)
    assert [room and room.name for room in rooms] == ["ct", None]
    assert rooms[0] is place.room(), "read once"
    bare = job.task.test_environment(place, "bca", "default", ("goal_image",))
    images = [job.seen(bare, room=room).reset(seed=0)[0]["image"].astype(float) for room in (place.room(), None)]
    assert np.abs(images[0] - images[1]).mean() > 10


@pytest.mark.parametrize(
    ("settings", "values", "message"),
    [
        (ExpertSettings, {"ct": "none.nii.gz"}, "phantom.ct=none.nii.gz is no file: give the path of the CT (NIfTI, "),
        (ExpertSettings, {"file": None}, "phantom.ct belongs to a file: give phantom.file=PATH too"),
        (EnnSettings, {}, "phantom.ct is shown by the stages phantoms, expert, rehearsal and unseen alone"),
        (ExpertSettings, {"film": False}, "phantom.ct needs stage.film=true: give it, or leave out the CT"),
        (UnseenSettings, {"xray": False}, "phantom.ct needs stage.xray=true: give it, or leave out the CT"),
        (PhantomsSettings, {"picture": False}, "phantom.ct needs stage.picture=true: give it, or leave out the CT"),
    ],
)
def test_a_ct_that_nothing_would_show_is_one_sentence(
    scan: dict[str, Any], settings: type, values: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=f"^{re.escape(message)}"):
        settings(**scan | values)


def test_the_ct_of_somebody_else_is_refused_before_the_work(scan: dict[str, Any], tmp_path: Path) -> None:
    nibabel = pytest.importorskip("nibabel", reason="a CT needs nibabel")
    own = nibabel.load(scan["ct"])
    away = own.affine.copy()
    away[:3, 3] += 400.0  # mm
    nibabel.save(nibabel.Nifti1Image(np.asarray(own.dataobj), away), tmp_path / "other.nii.gz")
    given = (f"phantom.file='{scan['file']}'", f"phantom.ct='{tmp_path / 'other.nii.gz'}'")
    settings = composed("stage=expert", "budget=smoke", *given, "target=bca").stage
    with pytest.raises(ConfigurationError, match=r"other\.nii\.gz"):
        load_stage("expert").prepare(settings)


def test_results_depend_on_the_ct(scan: dict[str, Any], tmp_path: Path) -> None:
    with_ct = ExpertSettings(**scan, phantoms=["x"], targets=["bca"])
    copy = tmp_path / "copy.nii.gz"
    copy.write_bytes(Path(scan["ct"]).read_bytes())
    assert replace(with_ct, ct=str(copy)).ct_sha256 == with_ct.ct_sha256
    copy.write_bytes(b"another")
    assert replace(with_ct, ct=str(copy)).ct_sha256 != with_ct.ct_sha256


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
    phantom = AnatomyFile.of(str(tmp_path / "vessels.dcm")).load()
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
    assert main(["stage=phantoms", *given, f"runs_dir={tmp_path}/runs"]) == 0
    folder = tmp_path / "runs" / "desk" / "phantoms" / "vessels"
    assert set(json.loads((folder / "targets.json").read_text())["targets"]) >= {"bca", "lcca", "lsa", "rsa", "rcca"}
    assert np.asarray(Image.open(folder / "radiograph.png"), float).std() > 20
    account = json.loads((folder / "import.json").read_text())
    assert account["volumes_ml"]["aorta"][0] == pytest.approx(account["volumes_ml"]["aorta"][1], rel=0.03)
    (note,) = (note for note in account["notes"] if "mm apart" in note)
    assert note.startswith("the CT and the vessels lie 5 mm apart")
    assert f"vessels: note: {note}" in capfd.readouterr().out
