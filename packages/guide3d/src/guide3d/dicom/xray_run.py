"""One X-ray run of a C-arm, as DICOM holds it: frames, their times, and where the C-arm stood."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from guide3d.dicom.header import Header, silent
from guide3d.dicom.stored_pixels import grey_tables, has_empty_window, stored_frames
from guide3d.geometry.polyline import Array

STEP_MS = (1.0, 60_000.0)  # from frame to frame
_RATES_APART = 0.1  # of two statements of one frame rate, as a share
_CONSTANT_DEG = 0.05  # angles that differ by less are the same: systems write them to a tenth


@dataclass(frozen=True, eq=False)
class XrayRun:
    """Frames and geometry of one run; nothing in it says whose they are. What the file leaves open is NaN or None.

    frames: (n, h, w) as stored, uint8 or uint16
    grey: (1 or n, levels) uint8, from stored to grey values, 0 black, by the file's window and inversion
    times_ms: (n,) from the first frame, or None
    primary_deg, secondary_deg: (n,) angles of the positioner; positive to the patient's left (LAO) and head (CRA)
    source_detector_mm, source_isocentre_mm: (n,)
    pixel_mm: (n, 2) at the detector, from column to column (x) and from row to row (y)
    field_of_view_mm: sides or diameter of the field at the detector, with its shape ("ROUND", "RECTANGLE"), or empty
    table_mm: (n, 3) vertical, longitudinal, lateral, as the file counts them
    orientation: to which side of the patient rows and columns run, e.g. ("L", "F"), or empty
    beam_tilt_deg: greatest angle between the beam and the detector's normal
    """

    path: Path
    frames: NDArray[np.uint8] | NDArray[np.uint16]
    grey: NDArray[np.uint8]
    times_ms: Array | None
    primary_deg: Array
    secondary_deg: Array
    source_detector_mm: Array
    source_isocentre_mm: Array
    pixel_mm: Array
    field_of_view_mm: tuple[float, ...]
    field_of_view_shape: str
    table_mm: Array
    orientation: tuple[str, ...]
    beam_tilt_deg: float
    warnings: tuple[str, ...]

    def __len__(self) -> int:
        """How many frames."""
        return len(self.frames)

    def image(self, frame: int) -> NDArray[np.uint8]:
        """A frame, counted from 0, as it is shown: (h, w) uint8, 0 black."""
        return self.grey[min(frame, len(self.grey) - 1)][self.frames[frame]]

    def images(self) -> NDArray[np.uint8]:
        """All frames as they are shown: (n, h, w) uint8, 0 black."""
        return np.stack([self.image(frame) for frame in range(len(self))])

    @property
    def moves(self) -> bool:
        """Whether the C-arm turns during the run."""
        turned = [np.ptp(angle) for angle in (self.primary_deg, self.secondary_deg) if np.isfinite(angle).all()]
        return bool(max(turned, default=0.0) > _CONSTANT_DEG)


def run_of(header: Header) -> XrayRun:
    """Decodes the run of a file.

    Raises:
        ValueError: as `read_xray`.
    """
    frames = stored_frames(header)
    n = len(frames)
    detector = _each(header, ("DistanceSourceToDetector",), n)
    isocentre = _each(header, ("DistanceSourceToIsocenter", "DistanceSourceToPatient"), n)
    magnification = _each(header, ("EstimatedRadiographicMagnificationFactor",), n)
    warnings = []
    if np.isnan(isocentre).any() and np.isfinite(detector / magnification).all():
        isocentre = detector / magnification
        warnings.append("the distance from source to isocentre follows from the estimated magnification")
    pixel, field = _spacings(header, n), header.numbers("FieldOfViewDimensions")
    shape = header.word("FieldOfViewShape")
    if np.isnan(pixel).any() and len(field) and header.kind in ("XA", "RF"):
        sides = field if len(field) == 2 else field[[0, 0]]  # row dimension (across) first
        pixel = np.tile(sides / [frames.shape[2], frames.shape[1]], (n, 1))
        warnings.append("the pixel spacing follows from the field of view, taken to fill the picture")
    if header.word("BurnedInAnnotation") == "YES":
        warnings.append("the file says that text is drawn into its pictures, which may name the patient")
    if any(has_empty_window(header, frame) for frame in range(n)):
        warnings.append("its window has no width and would show nothing: it is left out")
    grey, note = grey_tables(header, frames)
    warnings += [note] if note else []
    warnings += _subtraction(header)
    if any(header.number("RescaleSlope", frame) < 0 for frame in range(n)):
        warnings.append("its RescaleSlope is below 0, which is not applied: are its pictures a negative?")
    if header.word("Modality") not in ("", "XA", "RF"):
        warnings.append("its Modality is another one than XA or RF: are its pictures X-rays?")
    times = _times(header, n, warnings)
    tilt = header.numbers("DetectorPrimaryAngle"), header.numbers("DetectorSecondaryAngle")
    words = header.find("PatientOrientation")
    return XrayRun(
        path=header.path,
        frames=frames,
        grey=grey,
        times_ms=times,
        primary_deg=_angles(header, "Primary", n),
        secondary_deg=_angles(header, "Secondary", n),
        source_detector_mm=detector,
        source_isocentre_mm=isocentre,
        pixel_mm=pixel,
        field_of_view_mm=tuple(field.tolist()),
        field_of_view_shape=shape,
        table_mm=_table(header, n),
        orientation=() if words is None or len(words) != 2 else tuple(str(word).upper() for word in words),
        beam_tilt_deg=float(np.abs(np.concatenate([*tilt, [0.0]])).max()),
        warnings=tuple(warnings),
    )


def _each(header: Header, keywords: tuple[str, ...], n: int) -> Array:
    """The first of some attributes that is there, frame by frame: (n,), NaN where none is."""
    for keyword in keywords:
        values = np.array([header.number(keyword, frame) for frame in range(n)])
        if not np.isnan(values).all():
            return values
    return np.full(n, np.nan)


def _angles(header: Header, axis: str, n: int) -> Array:
    """(n,) degrees; of runs that turn, the first angle and what each frame adds to it.

    Source:
        DICOM PS3.3, C.8.7.5.1.3: one value is the mean step from frame to frame, n values are offsets from the first.
    """
    angles = _each(header, (f"Positioner{axis}Angle",), n)
    added = header.numbers(f"Positioner{axis}AngleIncrement")
    if len(added) == 1:
        return angles + added[0] * np.arange(n)
    if len(added) == n:
        return angles + added
    if len(added):
        raise ValueError(
            f"{header.path}: Positioner{axis}AngleIncrement should have one value or one for each of {n} frames, "
            f"found {len(added)}"
        )
    return angles


def _spacings(header: Header, n: int) -> Array:
    """(n, 2) mm from column to column and from row to row; DICOM has rows first."""
    spacing = np.full((n, 2), np.nan)
    for frame in range(n):
        spacings = header.numbers("ImagerPixelSpacing", frame)
        if len(spacings) == 2:
            spacing[frame] = spacings[::-1]
    return spacing


def _table(header: Header, n: int) -> Array:
    """(n, 3) mm: vertical, longitudinal, lateral; of plain runs, the height of the table and what each frame adds."""
    table = np.full((n, 3), np.nan)
    for column, axis in enumerate(("Vertical", "Longitudinal", "Lateral")):
        places = _each(header, (f"TableTop{axis}Position",), n)
        added = header.numbers(f"Table{axis}Increment")
        if np.isnan(places).all() and axis == "Vertical":
            places = _each(header, ("TableHeight",), n)
        if len(added) in (1, n):
            steps = added[0] * np.arange(n) if len(added) == 1 else added
            places = np.where(np.isnan(places), 0.0, places) + steps
        table[:, column] = places
    return table


def _subtraction(header: Header) -> list[str]:
    """A sentence where the file wants a mask subtracted: wires are read in the image as it was recorded."""
    items = header.find("MaskSubtractionSequence") or []
    with silent():
        try:
            masks = [item.get("MaskFrameNumbers") for item in items if item.get("MaskOperation") not in (None, "NONE")]
            frames = sorted({int(frame) for mask in masks if mask for frame in np.atleast_1d(mask)})
        except Exception:  # a value that its kind does not allow
            raise ValueError(f"{header.path}: MaskSubtractionSequence cannot be understood") from None
    if not masks and header.word("RecommendedViewingMode") != "SUB":
        return []
    mask = f" (frames {', '.join(map(str, frames[:8]))})" if frames else ""
    return [f"the file asks to subtract a mask{mask}: its frames are given as recorded, not subtracted"]


def _times(header: Header, n: int, warnings: list[str]) -> Array | None:
    """(n,) ms from the first frame, by the first that the file has: each frame's, steps, one step, or a rate."""
    moments = [header.find("FrameAcquisitionDateTime", frame) or header.find("FrameReferenceDateTime", frame)
               for frame in range(n)]  # fmt: skip
    parsed = [moment_of(str(moment)) for moment in moments if moment is not None]
    whole = [moment for moment in parsed if moment is not None]
    if len(whole) == n:
        return np.array([(moment - whole[0]).total_seconds() * 1e3 for moment in whole])
    steps = header.numbers("FrameTimeVector")
    step = header.number("FrameTime")
    if step < 0 or (steps[1:] < 0).any():
        raise ValueError(f"{header.path}: expected frames in the order of their times, found steps below 0 ms")
    if len(steps) == n > 1 and (steps[1:] > 0).any():
        return np.asarray(np.cumsum(steps) - steps[0], dtype=np.float64)
    if len(steps) not in (0, n):
        warnings.append(f"its FrameTimeVector has {len(steps)} values for {n} frames and is left out")
    if n > 1 and not np.isnan(step) and not STEP_MS[0] <= step <= STEP_MS[1]:
        warnings.append(f"its FrameTime is {step:g} ms, which is taken as not known")
        step = np.nan
    if n > 1 and abs(step * header.number("CineRate") / 1e3 - 1.0) > _RATES_APART:
        conflict = f"its FrameTime is {step:g} ms, but its CineRate {header.number('CineRate'):g} frames/s"
        warnings.append(f"{conflict}: the FrameTime is taken")
    for keyword in ("CineRate", "RecommendedDisplayFrameRate"):
        rate = header.number(keyword)
        if np.isnan(step) and rate > 0:
            step = 1e3 / rate
    if np.isnan(step):
        return np.zeros(1) if n == 1 else None
    return step * np.arange(n, dtype=np.float64)


def moment_of(text: str) -> datetime | None:
    """A DICOM date and time, without its offset from universal time, which is the same for all frames."""
    digits = text.split("+")[0].split("-")[0].strip()
    for form in ("%Y%m%d%H%M%S.%f", "%Y%m%d%H%M%S"):
        try:
            return datetime.strptime(digits, form)
        except ValueError:
            continue
    return None
