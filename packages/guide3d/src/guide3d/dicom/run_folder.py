"""Reads X-ray runs: a file, or a folder of files with a frame each, one series in the order of its numbers."""

from __future__ import annotations

from datetime import datetime
from itertools import pairwise
from pathlib import Path

import numpy as np

from guide3d.dicom.header import Header, OtherKindError, pydicom_reader
from guide3d.dicom.stored_pixels import frame_count
from guide3d.dicom.xray_run import STEP_MS, XrayRun, moment_of, run_of
from guide3d.files import files_in, numeric_order
from guide3d.geometry.polyline import Array
from guide3d.guarded_reading import call_in_child

_NAMED = 3  # files that a message names
_BY_FRAME = (
    "frames", "primary_deg", "secondary_deg", "source_detector_mm", "source_isocentre_mm", "pixel_mm", "table_mm",
)  # fmt: skip


def read_xray(path: str | Path) -> XrayRun:
    """Reads an X-ray run in a child process: XA or RF, enhanced or not, one frame or many.

    Args:
        path: a file, or a folder of single frames.

    Raises:
        FileNotFoundError: there is no such file.
        ImportError: pydicom is not installed.
        ValueError: the file is no X-ray run, or damaged, or its pictures cannot be decoded. No message quotes what the
            file says about the patient: that is never read.
    """
    pydicom_reader()  # what the child needs is imported before it is forked
    path = Path(path)
    return call_in_child(read_folder if path.is_dir() else read_file, path, subject=str(path))


def read_file(path: Path) -> XrayRun:
    """As `read_xray` of a file, in this process."""
    return run_of(Header(path))


def read_folder(folder: Path) -> XrayRun:
    """Reads the X-ray files of a folder as one run, by instance number, else by time, else by name.

    Raises:
        ValueError: the folder holds no X-ray files, several series or several runs, or frames of several sizes.
    """
    headers, others = [], []
    for path in files_in(folder, "*"):
        try:
            if path.is_file() and path.name.upper() != "DICOMDIR":
                headers.append(Header(path))
        except OtherKindError:
            others.append(path)
    if not headers:
        raise ValueError(f"folder {folder} holds no X-ray files (DICOM XA or RF)")
    warnings = [f"{len(others)} files that are no X-ray images were left out: {_names(others)}"] if others else []
    _require_one_series(folder, headers)
    runs = [header for header in headers if frame_count(header) > 1]
    if runs and len(headers) > 1:
        raise ValueError(
            f"{folder} holds files of several frames ({_names([one.path for one in runs])}): give one of them, not the "
            "folder"
        )
    moments = [_moment(header) for header in headers]
    order = _order(headers, moments, warnings)
    frames = [run_of(headers[place]) for place in order]
    several = [headers[place].path for place, run in zip(order, frames, strict=True) if len(run.frames) > 1]
    if several and len(headers) > 1:  # without a number of frames in their headers
        raise ValueError(f"{folder} holds files of several frames ({_names(several)}): give one, not the folder")
    shapes = {(run.frames.shape[1:], run.grey.shape[1]) for run in frames}
    if len(shapes) > 1:
        listed = ", ".join(f"{width} x {height} px" for (height, width), _ in sorted(shapes))
        raise ValueError(f"{folder} holds frames of several sizes or bits ({listed}): keep one kind in the folder")
    for run in frames:
        warnings += [warning for warning in run.warnings if warning not in warnings]
    first = frames[0]
    moments = [moments[place] for place in order]
    times = first.times_ms if len(frames) == 1 else _times(headers[order[0]], moments, warnings)
    tables = [run.grey for run in frames]
    values = {name: np.concatenate([getattr(run, name) for run in frames]) for name in _BY_FRAME}
    return XrayRun(
        path=folder,
        grey=tables[0] if all(np.array_equal(tables[0], table) for table in tables) else np.concatenate(tables),
        times_ms=times,
        field_of_view_mm=first.field_of_view_mm,
        field_of_view_shape=first.field_of_view_shape,
        orientation=first.orientation,
        beam_tilt_deg=max(run.beam_tilt_deg for run in frames),
        warnings=tuple(warnings),
        **values,
    )


def _require_one_series(folder: Path, headers: list[Header]) -> None:
    series: dict[str, list[Header]] = {}
    for header in headers:
        series.setdefault(header.word("SeriesInstanceUID"), []).append(header)
    if len(series) == 1:
        return
    listed = "; ".join(
        f"number {one[0].number('SeriesNumber'):g} with {len(one)} files ({_names([header.path for header in one])})"
        for one in series.values()
    )
    raise ValueError(f"{folder} holds {len(series)} series: {listed}; put the one that is meant in a folder of its own")


def _order(headers: list[Header], moments: list[datetime | None], warnings: list[str]) -> list[int]:
    """Places of the files in the order of their frames."""
    numbers = [header.number("InstanceNumber") for header in headers]
    places = list(range(len(headers)))
    times = [moment for moment in moments if moment is not None]
    by_time = sorted(places, key=lambda place: times[place]) if len(set(times)) == len(headers) else None
    if np.isfinite(numbers).all() and len(set(numbers)) == len(headers):
        by_number = sorted(places, key=lambda place: numbers[place])
        if by_time not in (None, by_number):
            warnings.append("its files have another order by time than by instance number, which was taken")
        missing = round(max(numbers) - min(numbers)) + 1 - len(headers)
        if missing > 0:
            warnings.append(f"{missing} instance numbers between the first and the last file are missing")
        return by_number
    if by_time is not None:
        warnings.append("its files have no instance numbers of their own: they were ordered by time")
        return by_time
    if len(headers) > 1:
        warnings.append("its files have neither instance numbers nor times of their own: they were ordered by name")
    return places


def _times(first: Header, moments: list[datetime | None], warnings: list[str]) -> Array | None:
    """(n,) ms from the first frame, by the files' times, else by the first one's time between frames."""
    known = [moment for moment in moments if moment is not None]
    if len(known) == len(moments) and all(a < b for a, b in pairwise(known)):
        return np.array([(moment - known[0]).total_seconds() * 1e3 for moment in known])
    step = first.number("FrameTime")
    if step > 0 and not STEP_MS[0] <= step <= STEP_MS[1]:
        warnings.append(f"its FrameTime is {step:g} ms, which is taken as not known")
        return None
    return step * np.arange(len(moments), dtype=np.float64) if step > 0 else None


def _moment(header: Header) -> datetime | None:
    """When a file's frame was recorded."""
    texts = [header.word("AcquisitionDateTime")]
    for kind in ("Acquisition", "Content"):
        time = header.word(f"{kind}Time")
        texts.append((header.word(f"{kind}Date") or "20000101") + time if time else "")
    return next((moment for text in texts if text and (moment := moment_of(text)) is not None), None)


def _names(paths: list[Path]) -> str:
    listing = ", ".join(path.name for path in numeric_order(paths)[:_NAMED])
    return f"{listing}, and {len(paths) - _NAMED} more" if len(paths) > _NAMED else listing
