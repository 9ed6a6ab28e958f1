"""Reads the wire in X-ray images: one to a curve in the image, two to a curve in space.

    python -m guide3d.read A                            one image
    python -m guide3d.read A B --cameras FOLDER         two images of one moment
    python -m guide3d.read A [B ...] --video            sequences: each frame is helped by the one before

A and B are pictures (PNG, JPEG, TIFF, BMP) or DICOM runs, with --video also films (.mp4, .mov, .avi, …), TIFFs of
several pages, folders of pictures in the order of the numbers in their names, or folders of single DICOM frames.
FOLDER of the cameras: *16710*.txt and *16709*.txt as XMALab writes them (world cm), or .yaml as OpenCV does; or
camera_a.yaml and camera_b.yaml; two DICOM runs need none. If it holds distortion maps (.npz) or X-rays of perforated
sheets (*ndistort*16710*, *ndistort*16709*), images are taken as recorded and the curves are undistorted.

Written to the output folder, each file whole or not at all:

    curve.csv               the curve, tip first: s, x, y, z, standard deviation in mm; of one image px and confidence
    curve.json              all of it: covariances, both images' curves, candidates, messages
    curve.mrk.json, .vtp    of two images: the curve for 3D Slicer and for VTK
    overlay_a.png, _b.png   the images with the curve, green where certain, red where guessed (overlay.png of one image)
    view.html               the wire in space, to be turned with the mouse
    frames.csv, frames.json of a sequence instead: a row a frame, and the curves

Messages go to stderr. The exit code is 0 if a curve was written, 1 if there is none.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from guide3d.calibration.folder import Rig, distortions_of, rigs_in
from guide3d.commands import in_words
from guide3d.geometry.distortion import Distortion
from guide3d.image_file import write_png
from guide3d.reading.image_reading import ImageReading, MapReader, read, shipped_reader
from guide3d.reading.image_source import Image, Source, dicom_cameras
from guide3d.reading.output.curve_files import (
    curve_markups,
    curve_polydata,
    curve_table,
    frame_row,
    frame_table,
    image_record,
    pair_record,
    write_record,
    write_text,
)
from guide3d.reading.output.overlay import draw_reading, space_page
from guide3d.reading.pair_reading import (
    FRAMES,
    FrameReading,
    PairReading,
    check_different,
    combine,
    read_pairs,
    read_sequence,
)
from guide3d.reconstruction.matching import clearly_better

_REPORT_EVERY_S = 5.0
_ONE = ("curve.csv", "curve.json", "overlay.png")
_PAIR = ("curve.csv", "curve.json", "curve.mrk.json", "curve.vtp", "overlay_a.png", "overlay_b.png", "view.html")
_SEQUENCE = ("frames.csv", "frames.json")
_PROGRAM = "python -m guide3d.read"


@dataclass(frozen=True, eq=False)
class _Geometry:
    rigs: list[Rig]
    distortions: tuple[Distortion, Distortion] | None


def arguments(words: Sequence[str] | None, program: str) -> argparse.Namespace:
    """Understands the command line."""
    description = (__doc__ or "").replace(_PROGRAM, program)
    parser = argparse.ArgumentParser(
        prog=program, description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("a", type=Path, metavar="A", help="image of camera A, or the only one")
    parser.add_argument("b", type=Path, metavar="B", nargs="?", help="image of camera B at the same moment")
    parser.add_argument("--cameras", type=Path, metavar="FOLDER", help="folder of both cameras' files")
    parser.add_argument("--output", type=Path, metavar="FOLDER", default=Path("reading"), help="default: reading")
    parser.add_argument("--video", action="store_true", help="A and B are sequences")
    parser.add_argument(
        "--frame", choices=FRAMES, default="auto",
        help="whether the images are as recorded or undistorted already, where distortions are known; default: auto",
    )  # fmt: skip
    parser.add_argument("--reader", type=Path, metavar="FILE", help="a trained reader instead of the shipped one")
    return parser.parse_args(words)


def main(words: Sequence[str] | None = None, program: str = _PROGRAM) -> int:
    """Runs the command line; returns its exit code."""
    options = arguments(words, program)
    try:
        _run(options)
    except (ImportError, OSError, ValueError) as error:
        sys.stderr.write(f"{program}: {in_words(error)}\n")
        return 1
    return 0


def _run(options: argparse.Namespace) -> None:
    if options.b is None and options.cameras is not None:
        raise ValueError("--cameras needs two images: python -m guide3d.read A B --cameras FOLDER")
    if options.output.exists() and not options.output.is_dir():
        raise ValueError(f"{options.output} is a file: --output needs a folder")
    options.earlier = any((options.output / record).is_file() for record in ("curve.json", "frames.json"))
    source_a = Source(options.a)
    if options.b is None:
        if options.video:
            readings = _frame_readings(read_sequence(source_a.images(), _reader(options)))
            _say_of_sources(options, source_a)
            _write_sequence(options, readings, source_a, None)
        else:
            _one(options, source_a)
            _say_of_sources(options, source_a)
        return
    source_b = Source(options.b)
    first = (source_a.first(), source_b.first())  # before the cameras: their distortions take seconds
    geometry = _geometry(options, source_a, source_b)
    network = _reader(options)
    if options.video:
        rig = geometry.rigs[0]
        if len(geometry.rigs) > 1:
            rig, _ = _fitting(options, first, geometry, network)
        frames = read_pairs(
            source_a.images(), source_b.images(), rig.cameras, geometry.distortions, options.frame, network
        )
        readings = _frame_readings(frames)
        _say_of_sources(options, source_a, source_b)
        _write_sequence(options, readings, source_a, source_b)
        return
    _, reading = _fitting(options, first, geometry, network)
    if not reading.accepted:
        raise ValueError(reading.refusal)
    _write_pair(options, first, reading)
    _say_of_sources(options, source_a, source_b)


def _say_of_sources(options: argparse.Namespace, *sources: Source) -> None:
    """Says what is to be said about the files, and which of their images were not read."""
    _say([note for source in sources for note in source.notes])
    rates = [source.rate for source in sources]
    if options.video and min(rates) > 0 and max(rates) > 1.1 * min(rates):
        sentence = f"A has {rates[0]:.4g} frames a second and B {rates[1]:.4g}"
        _say([f"{sentence}: frames of one number, taken as one moment, are not"])
    counts = [source.count for source in sources]
    if options.video and len(set(counts)) > 1:
        _say([f"A has {counts[0]} frames and B {counts[1]}: those without a partner were not read"])
    if not options.video:
        _say(
            [
                f"{source.path.name} holds {source.count} images, of which the first was read: add --video to read all"
                for source in sources
                if source.count > 1
            ]
        )


def _frame_readings(frames: Iterable[FrameReading]) -> list[FrameReading]:
    """All frames of a sequence; every few seconds stderr says how many were read."""
    read_so_far: list[FrameReading] = []
    report_time = time.monotonic()
    for frame in frames:
        read_so_far.append(frame)
        if time.monotonic() - report_time > _REPORT_EVERY_S:
            report_time = time.monotonic()
            sys.stderr.write(f"guide3d.read: {len(read_so_far)} frames\n")
    return read_so_far


def _one(options: argparse.Namespace, source: Source) -> None:
    image = source.first()
    reading = read(image, _reader(options))
    if not reading.found:
        raise ValueError(f"{source.path}: {'; '.join(reading.messages)}")
    write_text(curve_table(reading), options.output / "curve.csv")
    write_record(image_record(reading), options.output / "curve.json")
    write_png(draw_reading(image, reading), options.output / "overlay.png")
    _remove_earlier(options, _ONE)
    _say(reading.messages)
    x, y = reading.points_px[0]
    sys.stdout.write(
        f"{options.output}: a wire of {len(reading.points_px)} points, tip at {x:.1f}, {y:.1f} px, "
        f"confidence {reading.overall_confidence:.2f}\n"
    )


def _write_pair(options: argparse.Namespace, images: Sequence[Image], reading: PairReading) -> None:
    pictures = [draw_reading(image, view) for image, view in zip(images, reading.views, strict=True)]
    page = space_page([reading], pictures, f"Wire in {options.a.name} and {options.b.name}")
    write_text(curve_table(reading), options.output / "curve.csv")
    write_record(pair_record(reading), options.output / "curve.json")
    write_record(curve_markups(reading), options.output / "curve.mrk.json")
    write_text(curve_polydata(reading), options.output / "curve.vtp")
    for letter, picture in zip("ab", pictures, strict=True):
        write_png(picture, options.output / f"overlay_{letter}.png")
    write_text(page, options.output / "view.html")
    _remove_earlier(options, _PAIR)
    _say(reading.messages)
    x, y, z = reading.curve_mm[0]
    sys.stdout.write(
        f"{options.output}: {reading.reconstruction.length_mm:.0f} mm of wire, tip at {x:.1f}, {y:.1f}, {z:.1f} mm "
        f"(standard deviation {reading.sd_mm[0]:.2f} mm), epipolar residual {reading.residual_px:.2f} px\n"
    )


def _write_sequence(options: argparse.Namespace, frames: list[FrameReading], a: Source, b: Source | None) -> None:
    with_wire = [frame for frame in frames if _has_wire(frame.reading)]
    if not with_wire:
        raise ValueError(f"{a.path}: no wire was found in any of {len(frames)} frames ({frames[0].said or 'no wire'})")
    rows = [frame_row(number, frame.reading, frame.said) for number, frame in enumerate(frames)]
    records = [_record(frame) for frame in frames]
    page = None
    if b is not None:
        readings = [frame.reading if isinstance(frame.reading, PairReading) else None for frame in frames]
        frame_number = next(number for number, reading in enumerate(readings) if reading is not None)
        pictures = []
        for source, view in zip((a, b), _views(readings[frame_number]), strict=True):
            image = next(image for number, image in enumerate(source.images()) if number == frame_number)
            pictures.append(draw_reading(image, view))
        page = space_page(readings, pictures, f"Wire in {len(frames)} frames of {a.path.name} and {b.path.name}")
    write_text(frame_table(rows), options.output / "frames.csv")
    write_record(records, options.output / "frames.json")
    if page is not None:
        write_text(page, options.output / "view.html")
    _remove_earlier(options, (*_SEQUENCE, *(["view.html"] if page is not None else [])))
    sys.stdout.write(f"{options.output}: {len(frames)} frames, a wire in {len(with_wire)} of them\n")


def _remove_earlier(options: argparse.Namespace, written: Sequence[str]) -> None:
    """Removes what an earlier reading wrote and this one did not: its record tells that there was one."""
    names = sorted({*_ONE, *_PAIR, *_SEQUENCE} - set(written)) if options.earlier else []
    inputs = [one.resolve() for one in (options.a, options.b) if one is not None]
    stale = [file for name in names if (file := options.output / name).is_file() and file.resolve() not in inputs]
    for file in stale:
        file.unlink()
    if stale:
        _say([f"results of an earlier reading were removed: {', '.join(file.name for file in stale)}"])


def _views(reading: PairReading | None) -> tuple[ImageReading, ImageReading]:
    assert reading is not None
    return reading.views


def _has_wire(reading: ImageReading | PairReading | None) -> bool:
    return isinstance(reading, PairReading) or (isinstance(reading, ImageReading) and reading.found)


def _record(frame: FrameReading) -> dict[str, object]:
    if frame.reading is None:
        return {"found": False, "messages": [frame.said]}
    return pair_record(frame.reading) if isinstance(frame.reading, PairReading) else image_record(frame.reading)


def _geometry(options: argparse.Namespace, a: Source, b: Source) -> _Geometry:
    if options.cameras is not None:
        rigs = rigs_in(options.cameras)
        return _Geometry(rigs, None if options.frame == "undistorted" else distortions_of(options.cameras))
    if a.is_dicom() and b.is_dicom():
        if options.video and (a.run.moves or b.run.moves):
            raise ValueError("a C-arm turns during its run, so that one camera is not enough for --video: leave it out")
        return _Geometry([Rig("of the DICOM runs", dicom_cameras(a, b))], None)
    raise ValueError("two images need the cameras that took them: add --cameras FOLDER (two DICOM runs need none)")


def _fitting(
    options: argparse.Namespace, images: Sequence[Image], geometry: _Geometry, network: MapReader
) -> tuple[Rig, PairReading]:
    """The set of cameras that fits two images, and their reading; the images are read once."""
    for name, path, image, camera in zip("AB", (options.a, options.b), images, geometry.rigs[0].cameras, strict=True):
        if image.shape[:2] != (camera.height, camera.width):
            raise ValueError(
                f"{path} has {image.shape[1]} x {image.shape[0]} px, but camera {name} was calibrated for "
                f"{camera.width} x {camera.height}"
            )
    check_different(*images)
    views = []
    for path, image in zip((options.a, options.b), images, strict=True):
        try:
            view = read(image, network)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        if not view.found:
            raise ValueError(f"{path}: {'; '.join(view.messages)}")
        views.append(view)
    fits: list[tuple[Rig, PairReading]] = []
    wrong: ValueError | None = None
    for rig in geometry.rigs:
        try:
            fits.append((rig, combine(views, rig.cameras, geometry.distortions, options.frame)))
        except ValueError as error:
            wrong = error
    if not fits:
        raise wrong or ValueError("no cameras")
    best = min(fits, key=lambda fit: (not fit[1].accepted, fit[1].residual_px))
    if len(fits) > 1:
        # one pair of images hardly tells sets of one rig apart: among those that fit, the last by name is the newest
        fitting = [fit for fit in fits if not clearly_better(best[1].residual_px, fit[1].residual_px)]
        best = max(fitting, key=lambda fit: (fit[1].accepted, fit[0].name))
        listed = ", ".join(f"{rig.name} ({reading.residual_px:.2f} px)" for rig, reading in fits)
        _say([f"{best[0].name} was taken of several sets of cameras: {listed}; keep the one that is meant"])
    return best


def _reader(options: argparse.Namespace) -> MapReader:
    if options.reader is None:
        return shipped_reader()
    from guide3d.reading.maps import Reader

    return Reader.load(options.reader)


def _say(messages: Sequence[str]) -> None:
    for text in messages:
        sys.stderr.write(f"guide3d.read: note: {text}\n")
