"""A patient's CT in the place of the body: attenuation along rays, without the contrast that was in the vessels."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.anatomy.mesh.report import ImportReport, MeshRefusedError
from cathsim.anatomy.volume.files.reading import open_volume
from cathsim.anatomy.volume.files.source import VolumeSource
from cathsim.fluoroscopy.body import THORAX, Ellipsoid, MeasuredBody
from cathsim.fluoroscopy.patient.hounsfield import BONE_FACTOR, WATER
from cathsim.fluoroscopy.scene import SCENES, XRayScene, scene

BLOOD = 40  # Hounsfield units of blood without contrast
_WALL = 1.5e-3  # m around the lumen in which the CT's contrast is taken away
_STEP = 0.7  # of a voxel's smallest side, between samples of a ray
_INSIDE = 0.9  # of the lumen must lie within the CT
_DEEP = 1e-3  # m from the wall: there a voxel is blood
_LEAST, _MOST = -30.0, 900.0  # Hounsfield units of blood, with contrast or without
_BLOOD_SHARE = 0.85  # of the lumen's voxels must lie between
_CONTRAST = 150.0  # Hounsfield units: more is contrast agent
_NATIVE_SPREAD = 200.0  # Hounsfield units between the tenths of a lumen without contrast
_SHELL = (-5e-3, -2e-3)  # m from the wall, outside
_STANDS_OUT = 25.0  # Hounsfield units by which blood exceeds what lies around the vessels, on average
_BODY = -300  # Hounsfield units: more is body
_CROPPED = 0.15  # of a side face that is body: the CT is cut through the body
_AIR, _DENSEST = -1024, 3071  # of the scale
_LARGEST = 6e8  # voxels

Array = NDArray[np.float64]


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
    """

    def __init__(self, values: NDArray[np.int16], to_index: ArrayLike, *, beyond: bool = False) -> None:
        self.values = np.ascontiguousarray(values, dtype=np.int16)
        self.to_index = np.array(to_index, dtype=np.float64)
        self.beyond = beyond
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
        spacing: Array = np.linalg.norm(np.linalg.inv(self.to_index[:, :3]), axis=0)
        return spacing

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


def ct_body(path: str | Path, phantom: ImportedPhantom) -> CTBody:
    """Reads the CT that an imported phantom's labels were drawn on.

    The contrast agent in the phantom's lumen is replaced by blood: a contrast run adds its own. A CT that is cut
    through the body goes on as soft tissue within the thorax of the scene "patient".

    Args:
        path: of a NIfTI or NRRD file in Hounsfield units.
        phantom: imported from labels, or from a surface in the CT's coordinates.

    Raises:
        MeshRefusedError: a ValueError: it is no CT, or that of another patient.
    """
    path = Path(path).expanduser()
    report = phantom.imported
    if report is None:
        raise MeshRefusedError(
            f"{path.name} has no place: the phantom was not imported from a file; a CT belongs to an imported anatomy."
        )
    source = open_volume(path)
    if source.layers != 1 or float(np.prod(source.shape)) > _LARGEST:
        raise MeshRefusedError(f"{path.name} is too large for a CT ({source.shape} voxels); cut it to the chest.")
    values = _read(source)
    # from the CT's indices to the patient's axes, by the frame of the import
    turn = source.frame * source.metres
    affine = np.eye(4)
    affine[:3, :3] = turn @ source.affine[:3, :3]
    affine[:3, 3] = turn @ source.affine[:3, 3] + np.array(report.offset)
    to_index: Array = np.linalg.inv(affine).astype(np.float64)
    _replace_contrast(values, affine, to_index, phantom.grid, path.name)
    origin = np.asarray(phantom.grid.origin)
    centre = origin + (np.array(phantom.grid.shape) - 1) * phantom.grid.spacing / 2
    local = to_index[:3].copy()
    local[:, 3] += local[:, :3] @ centre
    return CTBody(values, local, beyond=_is_cropped(values))


def ct_scene(path: str | Path, phantom: ImportedPhantom, filling: str = "contrast") -> XRayScene:
    """The X-ray scene of a patient: the CT as the body, the phantom's lumen filled with fluid, contrast or air.

    Raises:
        MeshRefusedError: as of `ct_body`.
        ValueError: for an unknown filling.
    """
    patient = SCENES["patient"]
    body = ct_body(path, phantom)
    filled = scene("patient", filling).filling
    return XRayScene(
        "ct", (body,), surroundings=patient.surroundings, wall=0.0, wall_thickness=0.0, filling=filled,
        scatter=patient.scatter, middle=patient.middle,
    )  # fmt: skip


def _read(source: VolumeSource) -> NDArray[np.int16]:
    values = np.empty(source.shape, dtype=np.int16)
    for first, slab in source.slabs():
        if not np.isfinite(slab).all():
            raise MeshRefusedError(f"{source.path.name} holds missing or infinite values; export the CT again.")
        values[:, :, first : first + slab.shape[-1]] = np.clip(np.rint(slab[0]), _AIR, _DENSEST)
    low, high = float(np.percentile(values[::4, ::4, ::4], 1)), float(values.max())
    if not (low < -500 and high > 100):
        raise MeshRefusedError(
            f"{source.path.name} is no CT in Hounsfield units: its values lie between {low:g} and {high:g}, expected "
            "air "
            "near -1000 and bone above 100."
        )
    return values


def _replace_contrast(values: NDArray[np.int16], affine: Array, to_index: Array, grid: Any, file: str) -> None:
    """Puts blood in the lumen of a CT, after a check that it is this patient's."""
    corners = np.asarray(grid.bounds)
    box = np.array(np.meshgrid(*corners.T)).reshape(3, -1).T @ to_index[:3, :3].T + to_index[:3, 3]
    low = np.maximum(np.floor(box.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(box.max(axis=0)).astype(int) + 1, values.shape)
    lumen = np.asarray(grid.coordinates(grid.inside()))
    at = lumen @ to_index[:3, :3].T + to_index[:3, 3]
    held = float(np.mean(((at >= -0.5) & (at <= np.array(values.shape) - 0.5)).all(axis=1)))
    if held < _INSIDE:
        raise MeshRefusedError(
            f"{file} is another patient's CT, or lies in another frame: {100 * held:.0f} % of the vessels lie within "
            "it, "
            f"expected {100 * _INSIDE:.0f}; give the CT that the labels were drawn on."
        )
    blood: list[NDArray[np.int16]] = []
    around: list[NDArray[np.int16]] = []
    window = values[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
    for i, plane in enumerate(window):
        j, k = np.meshgrid(np.arange(plane.shape[0]), np.arange(plane.shape[1]), indexing="ij")
        index = np.stack([np.full(j.shape, i), j, k], axis=-1) + low
        depth = grid.sample(index @ affine[:3, :3].T + affine[:3, 3])
        blood.append(plane[depth > _DEEP])
        around.append(plane[(depth > _SHELL[0]) & (depth < _SHELL[1])])
        plane[(depth > -_WALL) & (plane > BLOOD)] = BLOOD
    _check_blood(np.concatenate(blood).astype(np.float64), np.concatenate(around).astype(np.float64), file)


def _check_blood(inside: Array, around: Array, file: str) -> None:
    """Refuses a CT in which the vessels are not filled with blood, as where they belong to somebody else."""
    if len(inside) == 0 or len(around) == 0:
        raise MeshRefusedError(
            f"{file} is too coarse for the vessels: none of its voxels lies within; give a finer CT."
        )
    share = float(np.mean((inside > _LEAST) & (inside < _MOST)))
    lowest, middle, highest = np.percentile(inside, (10, 50, 90))
    uneven = middle < _CONTRAST and highest - lowest > _NATIVE_SPREAD
    stands_out = float(inside.mean() - around.mean())
    if share < _BLOOD_SHARE or uneven or stands_out < _STANDS_OUT:
        raise MeshRefusedError(
            f"{file} is another patient's CT: the vessels would hold {lowest:.0f} to {highest:.0f} Hounsfield units "
            "(the "
            f"middle 80 % of their voxels), {stands_out:.0f} more than what lies around them; give the CT that the "
            "labels "
            "were drawn on."
        )


def _is_cropped(values: NDArray[np.int16]) -> bool:
    """Whether a CT is cut through the body at one of its sides; the ends along the body always are."""
    sides = (values[0], values[-1], values[:, 0], values[:, -1])
    return any(float(np.mean(side > _BODY)) > _CROPPED for side in sides)
