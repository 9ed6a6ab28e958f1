"""The native code, loaded once: MuJoCo's functions, the check of struct layouts, and what a control step measures."""

from __future__ import annotations

import ctypes
import functools
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

MAX_CONTACTS = 512
LAYOUT_FIELDS = (
    *("nq", "nv", "nu", "ngeom", "nuser_geom", "timestep", "geom_size", "geom_user", "ncon", "time"),
    *("qpos", "qvel", "ctrl", "qacc_warmstart", "geom_xpos", "geom_xmat"),
    *("contact_x", "contact_geom", "contact_efc_address"),
    *("geom_bodyid", "body_mass", "xanchor", "xaxis", "qfrc_applied"),
    *("efc_diagA", "contact_solref", "contact_solimp", "contact_surfacevel"),
    *("nuserdata", "userdata"),
    *("nefc", "M_rowadr", "qH", "qHDiagInv", "qacc_smooth", "efc_J", "efc_D", "efc_aref", "efc_force", "contact_mu"),
)


def _fields(kind: Any, *names: str) -> tuple[tuple[str, Any], ...]:
    return tuple((name, kind) for name in names)


# mj_step1 without mj_factorM: only the mass with the implicit damping and stiffness is ever solved with.
_FIRST_HALF = (
    *("mj_checkPos", "mj_checkVel", "mj_fwdKinematics", "mj_crb", "mj_collision", "mj_makeConstraint", "mj_island"),
    *("mj_projectConstraint", "mj_transmission", "mj_effBuild", "mj_fwdVelocity"),
)


class Engine(ctypes.Structure):
    """MuJoCo functions that the native code calls (struct Engine of step.h)."""

    _fields_ = (
        ("first_half", ctypes.c_void_p * len(_FIRST_HALF)),
        *_fields(ctypes.c_void_p, "forward", "second_half", "kinematics", "contact_force"),
        *_fields(ctypes.c_void_p, "check_acceleration", "integrate"),
    )


class SimulationStruct(ctypes.Structure):
    """One simulation (struct Simulation of step.h)."""

    _fields_ = (
        *_fields(ctypes.c_void_p, "model", "fine", "finest", "data", "saved", "workspace"),
        *_fields(ctypes.c_int, "solver_rows", "vessel_geom", "hulls", "first_geom", "last_geom", "refinement"),
        *_fields(ctypes.c_double, "tolerance", "rise", "deep"),
        *_fields(ctypes.c_int, "depth_samples"),
        *_fields(ctypes.c_double, "depth"),
        *_fields(ctypes.c_void_p, "drag", "loads"),
        *_fields(ctypes.c_double, "wall_stiffness"),
        *_fields(ctypes.c_void_p, "rod"),
        *_fields(ctypes.c_double * 3, "breath"),
        *_fields(ctypes.c_double, "breath_rate"),
    )


class BloodStruct(ctypes.Structure):
    """A velocity field of blood (struct Blood of blood.h)."""

    _fields_ = (
        *_fields(ctypes.c_int * 3, "size"),
        *_fields(ctypes.c_double * 3, "origin"),
        *_fields(ctypes.c_double, "inverse"),
        *_fields(ctypes.c_void_p, "nodes", "samples", "table"),
        *_fields(ctypes.c_int, "phases", "rows", "columns"),
        *_fields(ctypes.c_double, "frequency", "start"),
    )


class DragStruct(ctypes.Structure):
    """Drag of blood on a wire (struct Drag of blood.h)."""

    _fields_ = (
        *_fields(ctypes.c_void_p, "blood"),
        *_fields(ctypes.c_double, "across_viscous", "along_viscous", "across_layer", "along_layer"),
        *_fields(ctypes.c_double, "across_inertial", "spacing"),
    )


class StepSummary(ctypes.Structure):
    """What one control step reports (struct StepSummary of step.h)."""

    _fields_ = (
        *_fields(ctypes.c_double * 3, "force"),
        *_fields(ctypes.c_double, "force_max", "force_mean", "penetration_max"),
        *_fields(ctypes.c_int, "contacts", "refined", "warnings"),
        *_fields(ctypes.c_double * 3, "mean_force", "sheath_force"),
        *_fields(ctypes.c_double, "magnitude_sum", "contact_max"),
    )


def address(array: np.ndarray) -> ctypes.c_void_p:
    """Pointer to the first element of an array that must outlive its use."""
    return ctypes.c_void_p(array.ctypes.data)


def _find(folder: Path, pattern: str) -> Path | None:
    return next(iter(sorted(folder.glob(pattern))), None)


@functools.cache
def mujoco_library() -> ctypes.CDLL:
    """The MuJoCo library that the Python bindings have loaded."""
    path = _find(Path(mujoco.__file__).parent, "libmujoco*")
    if path is None:
        raise ImportError("cathsim found no libmujoco inside the mujoco package: reinstall mujoco")
    return ctypes.CDLL(str(path))


@functools.cache
def library() -> ctypes.CDLL:
    """Loads the native code, checks it against the running MuJoCo and installs the contact function.

    Returns:
        The library; its calls release the interpreter's lock.

    Raises:
        ImportError: it was not built, or was built for another MuJoCo.
    """
    path = _find(Path(__file__).parent.parent, "_native*.so") or _find(Path(__file__).parent.parent, "_native*.pyd")
    if path is None:
        raise ImportError(
            "cathsim's native code is not built: install a C compiler (Debian: apt install gcc libc6-dev), "
            "then run 'pip install ./packages/cathsim'"
        )
    native = ctypes.CDLL(str(path))
    native.cathsim_sources.restype = ctypes.c_char_p
    if native.cathsim_sources().decode() != _sources_digest(native.cathsim_sources().decode()):
        raise ImportError("cathsim's native code is older than its sources: run 'make setup', or install cathsim again")
    if native.cathsim_header_version() != mujoco.mj_version():
        built, running = native.cathsim_header_version(), mujoco.mj_version()
        raise ImportError(
            f"cathsim's native code was built for MuJoCo {built} and {running} is running: install that MuJoCo, or "
            "build cathsim for this one with 'pip install --force-reinstall --no-deps --no-build-isolation --no-binary "
            ":all: endonav-cathsim', in a checkout with ./packages/cathsim as the last word"
        )
    pointer, number = ctypes.c_void_p, ctypes.c_double
    native.cathsim_vessel_register.argtypes = (*2 * (pointer,), number, *2 * (pointer,), *3 * (number,), ctypes.c_int)
    native.cathsim_vessel_distances.argtypes = [ctypes.c_int, ctypes.c_int] + [ctypes.c_void_p] * 3
    native.cathsim_penetration.restype = ctypes.c_double
    table = ctypes.c_void_p.in_dll(mujoco_library(), "mjCOLLISIONFUNC")
    native.cathsim_contact_install(ctypes.c_void_p(ctypes.addressof(table)))
    model = mujoco.MjModel.from_xml_string(_PROBE)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    seen, expected = layout_seen(native, model, data), layout_expected(model, data)
    wrong = [name for name in LAYOUT_FIELDS if seen[name] != expected[name]]
    if wrong:
        raise ImportError(
            f"cathsim's native code and MuJoCo {mujoco.mj_versionString()} disagree on {', '.join(wrong)}: reinstall "
            "cathsim with 'pip install --force-reinstall --no-deps ./packages/cathsim'"
        )
    return native


def _sources_digest(built: str) -> str:
    """Digest of the C sources beside this package in a checkout; of an installed package, that of the build."""
    paths = sorted((Path(__file__).parent.parent / "native").glob("*.[ch]"))
    if not any(path.suffix == ".c" for path in paths):
        return built
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


_PROBE = """
<mujoco><option timestep="0.003"/><size nuser_geom="3" nuserdata="2"/><worldbody>
<geom type="plane" size="1 1 1" surfacevel="0.3 0.2 0 0 0 0"/>
<body pos="0.25 0 0.04"><joint name="lift" type="slide" axis="0 0 1"/>
<geom type="sphere" size="0.05" user="1 2 3"/></body>
</worldbody><actuator><motor joint="lift"/></actuator></mujoco>
"""


def layout_seen(native: ctypes.CDLL, model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, int]:
    """What the native code reads in a model and its data, by field."""
    seen = np.zeros(len(LAYOUT_FIELDS), np.int64)
    native.cathsim_layout(ctypes.c_void_p(model._address), ctypes.c_void_p(data._address), address(seen))
    return dict(zip(LAYOUT_FIELDS, seen.tolist(), strict=True))


def layout_expected(model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, int]:
    """The same fields as MuJoCo's own bindings give them."""
    contact = data.contact
    some = data.ncon > 0
    values = (
        *(model.nq, model.nv, model.nu, model.ngeom, model.nuser_geom, int(model.opt.timestep * 1e9 + 0.5)),
        *(model.geom_size.ctypes.data, model.geom_user.ctypes.data, data.ncon, int(data.time * 1e9 + 0.5)),
        *(array.ctypes.data for array in (data.qpos, data.qvel, data.ctrl, data.qacc_warmstart)),
        *(data.geom_xpos.ctypes.data, data.geom_xmat.ctypes.data),
        int(contact.pos[0, 0] * 1e9) if some else 0,
        int(contact.geom[0, 1]) if some else 0,
        int(contact.efc_address[0]) if some else 0,
        *(array.ctypes.data for array in (model.geom_bodyid, model.body_mass)),
        *(array.ctypes.data for array in (data.xanchor, data.xaxis, data.qfrc_applied, data.efc_diagA)),
        int(contact.solref[0, 0] * 1e9) if some else 0,
        int(contact.solimp[0, 0] * 1e9) if some else 0,
        int(contact.surfacevel[0, 0] * 1e9) if some else 0,
        model.nuserdata,
        data.userdata.ctypes.data if model.nuserdata else 0,
        data.nefc,
        model.M_rowadr.ctypes.data,
        *(array.ctypes.data for array in (data.qH, data.qHDiagInv, data.qacc_smooth)),
        *(array.ctypes.data for array in (data.efc_J, data.efc_D, data.efc_aref, data.efc_force)),
        int(contact.mu[0] * 1e9) if some else 0,
    )
    return dict(zip(LAYOUT_FIELDS, (int(value) for value in values), strict=True))


@functools.cache
def engine() -> Engine:
    """Addresses of MuJoCo's functions for the native code."""
    names = (
        *_FIRST_HALF,
        *("mj_forwardSkip", "mj_step2", "mj_kinematics", "mj_contactForce", "mj_checkAcc", "mj_integratePos"),
    )
    addresses = [ctypes.cast(getattr(mujoco_library(), name), ctypes.c_void_p).value for name in names]
    first = len(_FIRST_HALF)
    return Engine((ctypes.c_void_p * first)(*addresses[:first]), *addresses[first:])


@dataclass(frozen=True)
class Contacts:
    """Contacts with the wall in the substep in which their resultant was largest."""

    points: np.ndarray  # world positions, m. Shape (k, 3).
    forces: np.ndarray  # force of the wall on the device, N, world frame. Shape (k, 3).


class MeasuredContacts:
    """The buffers that a control step of some substeps writes to, and what they hold.

    Attributes:
        summary: of the last control step.
        depths: deepest penetration after each substep, m, where the simulation measures it. Shape (substeps,).
    """

    def __init__(self, substeps: int) -> None:
        self._points, self._forces = np.zeros((MAX_CONTACTS, 3)), np.zeros((MAX_CONTACTS, 3))
        self._scratch = np.zeros((4 * MAX_CONTACTS, 3))
        self.depths, self.summary = np.zeros(substeps), StepSummary()

    def arguments(self) -> tuple[Any, ...]:
        """The last arguments of `cathsim_step`."""
        arrays = self._points, self._forces, self._scratch, self.depths
        return MAX_CONTACTS, *(address(array) for array in arrays), ctypes.byref(self.summary)

    def clear(self) -> None:
        """Forgets the summary, and with it the contacts."""
        ctypes.memset(ctypes.byref(self.summary), 0, ctypes.sizeof(self.summary))

    def contacts(self) -> Contacts:
        """The contacts of the last control step, where their resultant was largest."""
        count = self.summary.contacts
        return Contacts(self._points[:count].copy(), self._forces[:count].copy())

    def padded(self) -> Contacts:
        """`contacts`, followed by rows of zeros: always of shape (MAX_CONTACTS, 3)."""
        count = self.summary.contacts
        padded = Contacts(np.zeros((MAX_CONTACTS, 3)), np.zeros((MAX_CONTACTS, 3)))
        padded.points[:count], padded.forces[:count] = self._points[:count], self._forces[:count]
        return padded

    def state(self) -> tuple[bytes, np.ndarray, np.ndarray]:
        """The measurement, for `restore`; without the depths."""
        contacts = self.contacts()
        return bytes(self.summary), contacts.points, contacts.forces

    def restore(self, state: tuple[bytes, np.ndarray, np.ndarray]) -> None:
        """Returns to a measurement of `state`."""
        summary, points, forces = state
        ctypes.memmove(ctypes.byref(self.summary), summary, ctypes.sizeof(self.summary))
        self._points[: len(points)], self._forces[: len(forces)] = points, forces
