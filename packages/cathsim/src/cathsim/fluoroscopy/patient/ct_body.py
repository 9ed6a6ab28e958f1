"""A patient's CT in the place of the body: attenuation along rays, without the contrast that was in the vessels."""

from __future__ import annotations

import ctypes
import logging
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.anatomy.mesh.report import ImportReport, MeshRefusedError
from cathsim.anatomy.volume.files.reading import in_child, open_volume
from cathsim.anatomy.volume.files.source import VolumeSource
from cathsim.fluoroscopy.materials import ATTENUATION
from cathsim.fluoroscopy.patient.identity import check_patient
from cathsim.fluoroscopy.scene import SCENES, THORAX, Ellipsoid, MeasuredBody, XRayScene, scene

WATER = ATTENUATION["water"]  # 1/m at 60 keV, the beam's effective energy
# Mass attenuation (m^2/kg) at 60 and 80 keV, and the bone's density (kg/m^3).
_BONE, _WATER = (0.03148, 0.02229), (0.02059, 0.01837)
_BONE_DENSITY, _WATER_DENSITY = 1920.0, 1000.0
_CT_ENERGY = 70.0  # keV


logger = logging.getLogger(__name__)
BLOOD = 40  # Hounsfield units of blood without contrast
_WALL = 1.5e-3  # m around the lumen in which the CT's contrast is taken away
_STEP = 0.7  # of a voxel's smallest side, between samples of a ray
_BODY = -300  # Hounsfield units: more is body
_CROPPED = 0.15  # of a side face that is body: the CT is cut through the body
_AIR, _DENSEST = -1024, 3071  # of the scale
_LARGEST = 6e8  # voxels
Array = NDArray[np.float64]


def _at_ct_energy(pair: tuple[float, float]) -> float:
    """A coefficient between 60 and 80 keV, by a straight line of logarithms."""
    share = np.log(_CT_ENERGY / 60.0) / np.log(80.0 / 60.0)
    return float(pair[0] * (pair[1] / pair[0]) ** share)


def _excess(bone: float, water: float) -> float:
    return bone * _BONE_DENSITY / (water * _WATER_DENSITY) - 1.0


# How much more bone's excess over water counts in the beam than in the CT: 1.21.
BONE_FACTOR = _excess(_BONE[0], _WATER[0]) / _excess(_at_ct_energy(_BONE), _at_ct_energy(_WATER))


def attenuation(hounsfield: ArrayLike) -> NDArray[np.float64]:
    """Linear attenuation (1/m) at the beam's effective energy, of any shape, never negative."""
    excess = np.asarray(hounsfield, dtype=np.float64) / 1000.0
    share: NDArray[np.float64] = 1.0 + np.where(excess > 0, BONE_FACTOR * excess, excess)
    return WATER * np.maximum(share, 0.0)


class ImportedPhantom(Protocol):
    """What a phantom has to offer."""

    @property
    def grid(self) -> Any:
        """Signed distance to the wall."""

    @property
    def imported(self) -> ImportReport | None:
        """The account of its import."""


class _CTStruct(ctypes.Structure):
    """struct CTVolume of fluoroscopy_ct.c."""

    _fields_ = (
        ("size", ctypes.c_int * 3),
        ("to_index", ctypes.c_double * 12),
        ("values", ctypes.c_void_p),
        ("water", ctypes.c_double),
        ("bone", ctypes.c_double),
        ("step", ctypes.c_double),
        ("body_centre", ctypes.c_double * 3),
        ("body_axes", ctypes.c_double * 3),
        ("body", ctypes.c_double),
    )


class CTBody(MeasuredBody):
    """A CT as one of the solids of an X-ray scene: `chord` gives optical depths, for its attenuation is one.

    Args:
        values: (nx, ny, nz) Hounsfield units.
        to_index: (3, 4) from places (m, patient's axes, from the phantom's centre) to indices.
        beyond: whether soft tissue is assumed around the CT, within a thorax: where it is cut through the body.
        notes: what is to be said about the CT, as sentences.
    """

    def __init__(
        self, values: NDArray[np.int16], to_index: ArrayLike, *, beyond: bool = False, notes: tuple[str, ...] = ()
    ) -> None:
        self.values = np.ascontiguousarray(values, dtype=np.int16)
        self.to_index = np.array(to_index, dtype=np.float64)
        self.beyond, self.notes = beyond, notes
        if self.values.ndim != 3 or min(self.values.shape) < 2 or self.to_index.shape != (3, 4):
            raise ValueError(
                f"a CT body needs at least 2 x 2 x 2 values and a (3, 4) matrix, got {self.values.shape} and "
                f"{self.to_index.shape}."
            )
        self.values.flags.writeable = False

    def __deepcopy__(self, memo: dict[int, object]) -> CTBody:
        return self  # never changes

    @property
    def spacing(self) -> Array:
        """(3,) m between voxels."""
        return np.linalg.norm(np.linalg.inv(self.to_index[:, :3]), axis=0)

    def chord(self, source: Array, directions: Array) -> Array:
        """Optical depth (...) of rays.

        Args:
            source: (3,) m, where the rays start, from the phantom's centre.
            directions: (..., 3) unit vectors.
        """
        from cathsim.contact.native import library

        thorax = THORAX[0]
        assert isinstance(thorax, Ellipsoid)
        struct = _CTStruct(
            (ctypes.c_int * 3)(*self.values.shape),
            (ctypes.c_double * 12)(*self.to_index.reshape(-1)),
            self.values.ctypes.data,
            WATER,
            BONE_FACTOR,
            _STEP * float(self.spacing.min()),
            (ctypes.c_double * 3)(*thorax.centre),
            (ctypes.c_double * 3)(*(thorax.semi_axes if self.beyond else (0.0,) * 3)),
            thorax.attenuation,
        )
        rays = np.ascontiguousarray(directions, dtype=np.float64)
        start = np.ascontiguousarray(source, dtype=np.float64)
        depths = np.empty(rays.shape[:-1])
        integrate = library().cathsim_fluoroscopy_ct
        integrate.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
        integrate.restype = None
        integrate(ctypes.addressof(struct), start.ctypes.data, depths.size, rays.ctypes.data, depths.ctypes.data)
        return depths


def ct_body(path: str | Path, phantom: ImportedPhantom, transform: str | None = None) -> CTBody:
    """Reads the CT that an imported phantom's labels were drawn on.

    The contrast agent in the phantom's lumen is replaced by blood: a contrast run adds its own. A CT that is cut
    through the body goes on as soft tissue within the thorax of the scene "patient".

    Args:
        path: of a NIfTI, NRRD or MetaImage file in Hounsfield units, or of the folder of a DICOM series.
        phantom: imported from labels, or from a surface in the CT's coordinates.
        transform: of a NIfTI file, "sform" or "qform": which of its affines is taken.

    Raises:
        MeshRefusedError: a ValueError: it is no CT, or that of another patient.
    """
    path = Path(path).expanduser()
    report = phantom.imported
    if report is None:
        raise MeshRefusedError(
            f"{path.name} has no place: the phantom was not imported from a file; a CT belongs to an imported anatomy."
        )
    source, values = in_child(_read, path, transform)
    body, refusal = None, None
    for affine in _placements(source, report):
        to_index: Array = np.linalg.inv(affine).astype(np.float64)
        try:
            stands_out, aside = check_patient(values, to_index, phantom.grid, path.name)
        except MeshRefusedError as error:
            refusal = refusal or error
        else:
            if body is None or stands_out > body[0]:
                body = stands_out, affine, to_index, aside
    if body is None:
        assert refusal is not None
        raise refusal
    _, affine, to_index, aside = body
    notes = (*(f"{path.name}: {note}" for note in source.notes), *((aside,) if aside else ()))
    for note in notes:
        logger.warning("%s.", note)
    _replace_contrast(values, affine, to_index, phantom.grid)
    origin = np.asarray(phantom.grid.origin)
    centre = origin + (np.array(phantom.grid.shape) - 1) * phantom.grid.spacing / 2
    local = to_index[:3].copy()
    local[:, 3] += local[:, :3] @ centre
    return CTBody(values, local, beyond=_is_cropped(values), notes=notes)


def ct_scene(
    path: str | Path, phantom: ImportedPhantom, filling: str = "contrast", transform: str | None = None
) -> XRayScene:
    """The X-ray scene of a patient: the CT as the body, the phantom's lumen filled with fluid, contrast or air.

    Args:
        path: as of `ct_body`, like the phantom and the transform.
        phantom: imported.
        filling: of the lumen.
        transform: of a NIfTI file.

    Raises:
        MeshRefusedError: as of `ct_body`.
        ValueError: for an unknown filling.
    """
    patient = SCENES["patient"]
    body = ct_body(path, phantom, transform)
    filled = scene("patient", filling).filling
    return XRayScene(
        "ct", (body,), surroundings=patient.surroundings, wall=0.0, wall_thickness=0.0, filling=filled,
        scatter=patient.scatter, middle=patient.middle,
    )  # fmt: skip


def _read(path: Path, transform: str | None) -> tuple[VolumeSource, NDArray[np.int16]]:
    source = open_volume(path, transform, image=True)
    if source.layers != 1 or math.prod(source.shape) > _LARGEST:
        raise MeshRefusedError(f"{path.name} is too large for a CT ({source.shape} voxels); cut it to the chest.")
    values = np.empty(source.shape, dtype=np.int16)
    for first, slab in source.slabs():
        if not np.isfinite(slab).all():
            raise MeshRefusedError(f"{source.path.name} holds missing or infinite values; export the CT again.")
        values[:, :, first : first + slab.shape[-1]] = np.clip(np.rint(slab[0]), _AIR, _DENSEST)
    low, high = float(np.percentile(values[::4, ::4, ::4], 1)), float(values.max())
    if not (low < -500 and high > 100):
        raise MeshRefusedError(
            f"{source.path.name} is no CT in Hounsfield units: its values lie between {low:g} and {high:g}, expected "
            "air near -1000 and bone above 100."
        )
    return replace(source, values=_read_already), values


def _read_already() -> NDArray:
    """Stands for values that a process of its own has read."""
    return np.empty(0)


def _placements(source: VolumeSource, report: ImportReport) -> list[Array]:
    """(4, 4) from the CT's indices to the world, m: of a surface, whose file says neither, for either of two frames."""
    turn = source.frame * source.metres
    placements = []
    rotation = np.array(report.rotation)
    for axes in [np.eye(3)] if report.from_labels else [rotation, rotation @ np.diag((-1.0, -1.0, 1.0))]:
        affine = np.eye(4)
        affine[:3, :3] = axes @ turn @ source.affine[:3, :3]
        affine[:3, 3] = axes @ turn @ source.affine[:3, 3] + np.array(report.offset)
        placements.append(affine)
    return placements


def _replace_contrast(values: NDArray[np.int16], affine: Array, to_index: Array, grid: Any) -> None:
    """Puts blood in the lumen of a CT and in the wall around it."""
    corners = np.asarray(grid.bounds)
    box = np.array(np.meshgrid(*corners.T)).reshape(3, -1).T @ to_index[:3, :3].T + to_index[:3, 3]
    low = np.maximum(np.floor(box.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(box.max(axis=0)).astype(int) + 1, values.shape)
    window = values[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
    for i, plane in enumerate(window):
        j, k = np.meshgrid(np.arange(plane.shape[0]), np.arange(plane.shape[1]), indexing="ij")
        index = np.stack([np.full(j.shape, i), j, k], axis=-1) + low
        depth = grid.sample(index @ affine[:3, :3].T + affine[:3, 3])
        plane[(depth > -_WALL) & (plane > BLOOD)] = BLOOD


def _is_cropped(values: NDArray[np.int16]) -> bool:
    """Whether a CT is cut through the body at one of its sides; the ends along the body always are."""
    sides = (values[0], values[-1], values[:, 0], values[:, -1])
    return any(float(np.mean(side > _BODY)) > _CROPPED for side in sides)
