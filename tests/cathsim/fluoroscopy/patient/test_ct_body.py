"""A patient's CT around the vessels: attenuation, frames, contrast, refusals."""

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cathsim.anatomy import Phantom, load_phantom
from cathsim.anatomy.mesh.report import ImportReport, MeshRefusedError
from cathsim.fluoroscopy import BiplaneFluoroscope, Box, CTBody, Projector, ct_body, ct_scene
from cathsim.fluoroscopy.materials import ATTENUATION
from cathsim.fluoroscopy.patient.ct_body import BONE_FACTOR, WATER, attenuation
from cathsim.fluoroscopy.scene import body_depth

nibabel = pytest.importorskip("nibabel", reason="a CT needs nibabel")

Scan = Callable[..., Path]
SPACING = np.array([2.5e-3, 2.0e-3, 3.0e-3])
BEAD = np.array([0.030, 0.050, 0.040])  # m, patient's axes, from the phantom's centre
HALF = np.array([0.12, 0.09, 0.15])


def indices(values: np.ndarray) -> np.ndarray:
    """(3, 4) from places about the middle of an upright volume to its indices."""
    scale = np.diag(1 / SPACING)
    return np.column_stack([scale, (np.array(values.shape) - 1) / 2])


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return load_phantom("type_1")


@pytest.fixture(scope="module")
def patient(phantom: Phantom) -> Any:
    """A phantom as an import from labels leaves it: its frame is that of a file in right, anterior, superior."""
    offset = (0.013, -0.2, 1.1)
    rotation = ((-1.0, 0, 0), (0, -1.0, 0), (0, 0, 1.0))
    report = ImportReport("labels.nii.gz", "mm", "", 0, "labels", 0, rotation, offset, 1e-3, True, {}, {}, ())
    return SimpleNamespace(grid=phantom.grid, imported=report, bounds=phantom.bounds, hash="patient")


@pytest.fixture(scope="module")
def scan(patient: Any) -> Scan:
    """Writes a CT with contrast in the vessels, a bead of bone, and air around a block of soft tissue."""
    shape, centre, drawn = np.array([110, 110, 110]), middle(patient), {}

    def write(path: Path, *, shift: tuple[float, float, float] = (0, 0, 0), turn: float = 0.2) -> Path:
        c, s = np.cos(turn), np.sin(turn)
        axes = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.diag(SPACING)
        if turn not in drawn:
            index = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1)
            places = (index - (shape - 1) / 2) @ axes.T + centre
            values = np.full(tuple(shape), -1000.0)
            values[(np.abs(places - centre) < HALF).all(axis=-1)] = 0
            values[patient.grid.sample(places) > 0] = 350
            values[np.linalg.norm(places - centre - BEAD, axis=-1) < 4e-3] = 1800
            drawn[turn] = values.astype(np.int16)
        world = np.eye(4)
        flip = np.diag([-1.0, -1.0, 1.0])
        # the file's world is that of the labels: the phantom's place less the offset of the import
        world[:3, :3] = 1e3 * flip @ axes
        world[:3, 3] = 1e3 * flip @ (centre - axes @ (shape - 1) / 2 + shift - np.array(patient.imported.offset))
        image = nibabel.Nifti1Image(drawn[turn], world)
        image.header.set_xyzt_units("mm")
        nibabel.save(image, path)
        return path

    return write


@pytest.fixture(scope="module")
def body(scan: Scan, patient: Any, tmp_path_factory: pytest.TempPathFactory) -> CTBody:
    return ct_body(scan(tmp_path_factory.mktemp("ct") / "ct.nii.gz"), patient)


def middle(patient: Any) -> np.ndarray:
    grid = patient.grid
    return np.asarray(grid.origin) + (np.array(grid.shape) - 1) * grid.spacing / 2


def test_water_attenuates_as_a_block_of_water_does() -> None:
    values = np.full((40, 50, 30), 0, dtype=np.int16)
    ct = CTBody(values, indices(values))
    half = np.array(values.shape) * SPACING / 2
    block = Box((0.0, 0.0, 0.0), tuple(half), WATER)
    for primary, secondary in ((0, 0), (90, 0), (37, 21)):
        camera = Projector.c_arm(
            centre=np.zeros(3), field_of_view=0.1, size=48, primary_deg=primary, secondary_deg=secondary
        )
        found = body_depth(camera, (ct,), np.zeros(3))
        np.testing.assert_allclose(found, body_depth(camera, (block,), np.zeros(3)), rtol=1e-4, atol=1e-5)


def test_a_bead_is_seen_where_it_is_and_contrast_in_the_vessels_is_replaced_by_blood(
    body: CTBody, patient: Any
) -> None:
    for view in ("frontal", "lateral", "rao_30"):
        camera = Projector.view(view, patient.bounds, 200)
        depth = body_depth(camera, (body,), middle(patient))
        at = camera.project((middle(patient) + BEAD)[None])[0]
        v, u = np.rint(at[::-1]).astype(int)
        around = depth[v - 12 : v + 13, u - 12 : u + 13]
        peak = np.array(np.unravel_index(int(np.argmax(around)), around.shape)) - 12
        assert np.linalg.norm(peak) <= 2
    assert not ((body.values > 60) & (body.values < 1000)).any()
    assert (body.values == 40).any()
    assert not body.beyond  # air is all around
    assert pickle.loads(pickle.dumps(body)).values.shape == body.values.shape


def test_a_ct_cut_through_the_body_goes_on_as_a_thorax(scan: Scan, tmp_path: Path, patient: Any) -> None:
    image = nibabel.load(scan(tmp_path / "ct.nii.gz", turn=0.0))
    nibabel.save(image.slicer[25:85, 30:80, :], tmp_path / "cut.nii.gz")
    cut = ct_body(tmp_path / "cut.nii.gz", patient)
    assert cut.beyond
    depth = cut.chord(np.array([0.0, -0.7, 0.0]), np.array([[0.0, 1.0, 0.0]]))[0]
    assert depth == pytest.approx(0.23 * 20.5, rel=0.05)  # from the chest's front to the back


def test_the_contrast_run_comes_from_the_labels(scan: Scan, tmp_path: Path, patient: Any) -> None:
    path = scan(tmp_path / "ct.nii.gz")
    plain, filled = (
        BiplaneFluoroscope.of(patient, "clinical", size=96, surroundings=ct_scene(path, patient, filling))
        for filling in ("fluid", "contrast")
    )
    for name in ("a", "b"):
        without, contrast = (scope.render(np.zeros((0, 3)))[name].image.astype(float) for scope in (plain, filled))
        lumen = np.zeros(without.shape, dtype=bool)
        u, v = np.rint(plain.cameras[name].pixels(patient.grid.coordinates(patient.grid.inside()))).astype(int).T
        seen = (u >= 0) & (v >= 0) & (u < 96) & (v < 96)
        lumen[v[seen], u[seen]] = True
        ratio = contrast / np.maximum(without, 1)
        assert np.median(ratio[lumen]) < 0.9 * np.median(ratio[~lumen])


@pytest.mark.parametrize("shift", [(0.5, 0, 0), (0.0, 0.0, 0.12), (0.07, 0.0, 0.0)])
def test_the_ct_of_another_patient(scan: Scan, tmp_path: Path, patient: Any, shift: tuple[float, float, float]) -> None:
    with pytest.raises(MeshRefusedError, match="another patient"):
        ct_body(scan(tmp_path / "ct.nii.gz", shift=shift), patient)


@pytest.mark.parametrize(("shift", "told"), [(0.002, ()), (0.005, ("5 mm",))])
def test_a_ct_a_little_aside_is_noted(
    scan: Scan, tmp_path: Path, patient: Any, caplog: pytest.LogCaptureFixture, shift: float, told: tuple[str, ...]
) -> None:
    notes = ct_body(scan(tmp_path / "ct.nii.gz", shift=(shift, 0, 0)), patient).notes
    assert [note.partition(": ")[0] for note in notes] == [f"ct.nii.gz and the vessels lie {far} apart" for far in told]
    assert [record.message for record in caplog.records] == [f"{note}." for note in notes]


def test_what_is_no_ct(tmp_path: Path, patient: Any, phantom: Phantom) -> None:
    image = nibabel.Nifti1Image(np.ones((20, 20, 20), np.int16), np.eye(4))
    nibabel.save(image, tmp_path / "mask.nii.gz")
    with pytest.raises(MeshRefusedError, match="no CT in Hounsfield units"):
        ct_body(tmp_path / "mask.nii.gz", patient)
    with pytest.raises(MeshRefusedError, match="not imported from a file"):
        ct_body(tmp_path / "mask.nii.gz", phantom)
    with pytest.raises(MeshRefusedError, match="there is no file"):
        ct_body(tmp_path / "absent.nii.gz", patient)
    with pytest.raises(ValueError, match="at least 2 x 2 x 2"):
        CTBody(np.zeros((3, 3)), np.zeros((3, 4)))


@pytest.mark.parametrize(
    ("shift", "where"),
    [
        ((0, -0.01, 0), "(9|10|11) mm in front of where"),
        ((-0.018, 0.01, 0), "1[789] mm right of and (9|10|11) mm behind where"),
        ((0, 0, 0.02), "(19|20|21) mm above where"),
        ((0.01, 0, -0.02), "(19|20|21) mm below and (9|10|11) mm left of where"),
    ],
)
def test_a_ct_that_lies_beside_the_vessels_is_refused_with_the_way_to_it(
    scan: Scan, tmp_path: Path, patient: Any, shift: tuple[float, float, float], where: str
) -> None:
    with pytest.raises(MeshRefusedError, match=f"lies beside the vessels.* Hounsfield units {where}"):
        ct_body(scan(tmp_path / "ct.nii.gz", shift=shift), patient)


@pytest.mark.parametrize("axes", [np.diag([-1.0, -1.0, 1.0]), np.eye(3)])
def test_a_surface_in_either_frame_that_was_turned_upright_has_its_ct_turned_too(
    scan: Scan, body: CTBody, tmp_path: Path, patient: Any, axes: np.ndarray
) -> None:
    path, upright = scan(tmp_path / "ct.nii.gz"), np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    # the phantom and the account of its import, turned about the world's vertical axis
    report = patient.imported
    own = replace(report, kind="closed lumen", rotation=tuple(map(tuple, axes)))
    here = ct_body(path, SimpleNamespace(grid=patient.grid, imported=own))
    np.testing.assert_allclose(here.to_index, body.to_index, atol=1e-6)

    class Turned:
        bounds = _turned_bounds(patient.grid.bounds, upright)
        origin, shape, spacing = patient.grid.origin, patient.grid.shape, patient.grid.spacing

        def sample(self, places: np.ndarray) -> np.ndarray:
            return patient.grid.sample(places @ upright)

        def inside(self) -> np.ndarray:
            return patient.grid.inside()

        def coordinates(self, inside: np.ndarray) -> np.ndarray:
            return np.asarray(patient.grid.coordinates(inside)) @ upright.T

    turned = replace(own, rotation=tuple(map(tuple, upright @ axes)), offset=tuple(upright @ np.array(report.offset)))
    found = ct_body(path, SimpleNamespace(grid=Turned(), imported=turned))
    np.testing.assert_allclose(found.to_index[:, :3], body.to_index[:, :3] @ upright.T, atol=1e-6)


def _turned_bounds(bounds: np.ndarray, turn: np.ndarray) -> np.ndarray:
    corners = np.array(np.meshgrid(*np.asarray(bounds).T)).reshape(3, -1).T @ turn.T
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def test_air_water_and_bone() -> None:
    assert attenuation(-1000) == 0
    assert attenuation(0) == pytest.approx(WATER)
    assert attenuation(-1024) == 0
    # cortical bone has 1,593 Hounsfield units at 70 keV and this attenuation at 60
    assert attenuation(1593) == pytest.approx(ATTENUATION["bone"], rel=0.01)
    assert 1.15 < BONE_FACTOR < 1.25
