"""Episodes in Rerun: a log's scene, pictures and curves as a recording, saved to a file or shown in the viewer.

Every function raises a `ViewerError` where Rerun is not installed; what reads a log, an `EpisodeReadError` where that
is damaged.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.episodes.encoding.png import encode_image
from pipeline.episodes.reader import EpisodeReader
from pipeline.episodes.records import DeviceRecord, ViewerError
from pipeline.store.atomic_files import atomic_path

if TYPE_CHECKING:
    from rerun import RecordingStream

APPLICATION = "endonav"
STEP_TIMELINE, TIME_TIMELINE = "step", "time"
CURVES = {
    "force_n": "contact force, N",
    "insertion_m": "insertion, m",
    "rotation_rad": "rotation, rad",
    "reward": "reward",
}
DEVICE_CURVES = {  # of a log with a catheter: a curve for the wire and one for the catheter
    "device_insertions_m": ("insertions", "insertions of wire and catheter, m"),
    "hub_rotations_rad": ("hub_rotations", "rotations of the hubs, rad"),
    "tip_rotations_rad": ("tip_rotations", "rotations of the tips, rad"),
    "feeder_forces_n": ("feeder_forces", "forces of the feeders, N"),
    "hub_torques_nm": ("hub_torques", "torques at the hubs, N m"),
}
WIRE_RADIUS = 0.0008  # twice the wire's own, so that it is seen, m
CATHETER_RADIUS = 0.0012
ARROW_LENGTH = 0.05  # of a force of one newton, m
DETECTOR_DISTANCE = 0.12  # from the world's origin to where a camera's picture hangs, m
EYE_DISTANCE = 0.36  # of the first look at the scene, from the patient's front, m
_WALL = (217, 115, 115, 90)
_WIRE, _CATHETER = (30, 30, 40), (64, 115, 217, 160)
_TARGET, _ENTRY, _FORCE = (26, 179, 51), (51, 102, 230), (240, 140, 20)
_MASK, _FRUSTUM = (230, 60, 40), (150, 150, 160)


def rerun_module() -> ModuleType:
    """The Rerun package; a ViewerError where it is not installed."""
    try:
        import rerun
    except ModuleNotFoundError as error:
        raise ViewerError(
            "viewing in Rerun needs the extra rerun, which is not installed: run `pip install -c constraints.txt "
            "'.[rerun]'` in the project's folder"
        ) from error
    return rerun


def log_episode(log: EpisodeReader, recording: RecordingStream) -> None:
    """Sends a whole episode to a Rerun recording.

    | entity                      | what                                                                    |
    |-----------------------------|-------------------------------------------------------------------------|
    | world/phantom, target, entry| the lumen's wall, the target and the entry; always there                |
    | world/wire, tip, contacts   | the wire as a line, its tip, the wall's forces as arrows; every step    |
    | world/catheter              | the catheter as a line, where there is one; the tip is the foremost     |
    | world/camera/<name>         | the C-arm as a pinhole, and its picture with the wire's mask over it    |
    | curves/<name>               | force, insertion, rotation, reward and further scalars, unit in the name|
    | curves/<name>/wire, catheter| with a catheter: insertions, rotations, feeders' forces, hubs' torques  |
    | episode                     | what the log says of itself                                             |

    Timelines are `step` and `time`, the seconds since the reset. Lengths are metres in the world frame of the log.
    """
    rr = rerun_module()
    _log_static(rr, log, recording)
    curves: dict[str, list[float]] = {name: [] for name in CURVES}
    steps: list[int] = []
    for index, record in enumerate(log):
        _set_step(log, recording, record.step)
        devices = record.devices
        wire = record.wire_points if devices is None else devices.wire_points
        recording.log("world/wire", rr.LineStrips3D([wire], radii=WIRE_RADIUS, colors=_WIRE))
        if devices is not None:
            line = rr.LineStrips3D([devices.catheter_points], radii=CATHETER_RADIUS, colors=_CATHETER)
            recording.log("world/catheter", line)
        recording.log("world/tip", rr.Points3D([record.tip], radii=1.5 * WIRE_RADIUS, colors=_FORCE))
        arrows = ARROW_LENGTH * record.contact_forces
        recording.log("world/contacts", rr.Arrows3D(vectors=arrows, origins=record.contact_positions, colors=_FORCE))
        steps.append(record.step)
        values = {
            "force_n": record.resultant_force_norm,
            "insertion_m": record.insertion,
            "rotation_rad": record.rotation,
            "reward": record.reward,
            **record.extra,
            **_device_curves(devices),
        }
        for name, value in values.items():
            curves.setdefault(name, [np.nan] * index).append(value)
        for values_so_far in curves.values():
            values_so_far.extend([np.nan] * (index + 1 - len(values_so_far)))
    _log_pictures(rr, log, recording)
    times = [
        rr.TimeColumn(STEP_TIMELINE, sequence=steps),
        rr.TimeColumn(TIME_TIMELINE, duration=[step * log.info.control_dt for step in steps]),
    ]
    for name, values_of_all in curves.items():
        if steps:
            recording.send_columns(f"curves/{name}", indexes=times, columns=rr.Scalars.columns(scalars=values_of_all))


def _device_curves(devices: DeviceRecord | None) -> dict[str, float]:
    """Entity below `curves` -> value of a step."""
    if devices is None:
        return {}
    pairs = {
        f"{curve}/{device}": float(value)
        for curve, (field, _) in DEVICE_CURVES.items()
        for device, value in zip(("wire", "catheter"), getattr(devices, field), strict=True)
    }
    return {**pairs, "lead_m": devices.lead}


def _log_static(rr: ModuleType, log: EpisodeReader, recording: RecordingStream) -> None:
    """What holds for the whole episode: frame, phantom, cameras, names, and the log's own information."""
    # the world's axes: to the patient's left, to the back, to the head
    recording.log("world", rr.ViewCoordinates.LBU, static=True)
    mesh = log.phantom_mesh()
    if mesh is not None:
        wall = rr.Mesh3D(vertex_positions=mesh.vertices, triangle_indices=mesh.faces, albedo_factor=_WALL)
        recording.log("world/phantom", wall, static=True)
        for name, centre, colour in (("target", mesh.target, _TARGET), ("entry", mesh.entry, _ENTRY)):
            recording.log(f"world/{name}", rr.Points3D([centre], radii=0.002, colors=colour, labels=name), static=True)
    for name in log.cameras:
        camera = log.camera(name)
        pose = rr.Transform3D(translation=-camera.R.T @ camera.t, mat3x3=camera.R.T)
        # the picture hangs behind the patient, where the detector is
        detector = float(np.linalg.norm(camera.t)) + DETECTOR_DISTANCE
        lens = rr.Pinhole(
            image_from_camera=camera.K,
            resolution=(camera.width, camera.height),
            image_plane_distance=detector,
            line_width=0.0003,
            color=_FRUSTUM,
        )
        recording.log(f"world/camera/{name}", pose, lens, static=True)
        classes = rr.AnnotationContext([(0, "", (0, 0, 0, 0)), (1, "wire", _MASK)])
        recording.log(f"world/camera/{name}", classes, static=True)
    for curve, label in CURVES.items():
        recording.log(f"curves/{curve}", rr.SeriesLines(names=label), static=True)
    info, outcome = log.info, log.outcome
    success = {True: "reached", False: "not reached", None: "not known to be reached"}[outcome.success]
    rows = [
        f"# {info.phantom}, {info.entry} to {info.target}" + (f", {info.catheter_name}" if info.has_catheter else ""),
        f"{outcome.steps} steps of {info.control_dt:g} s, steered by {info.operator}, seed {info.seed}",
        f"target {success}, log {outcome.status}",
        *(
            f"- {name}: {value:.4g}" if isinstance(value, float) else f"- {name}: {value}"
            for name, value in sorted(outcome.metrics.items())
        ),
    ]
    document = rr.TextDocument("\n\n".join(rows[:3]) + "\n\n" + "\n".join(rows[3:]), media_type="text/markdown")
    recording.log("episode", document, static=True)


def _log_pictures(rr: ModuleType, log: EpisodeReader, recording: RecordingStream) -> None:
    for name in log.cameras:
        for stream in ("image", "mask"):
            if not log.has(name, stream):
                continue
            for step, pixels in log.pictures(name, stream):
                _set_step(log, recording, step)
                if stream == "image":
                    picture = rr.EncodedImage(contents=encode_image(pixels), media_type="image/png")
                else:
                    picture = rr.SegmentationImage(pixels.astype(np.uint8), opacity=0.5)
                recording.log(f"world/camera/{name}/{stream}", picture)


def _set_step(log: EpisodeReader, recording: RecordingStream, step: int) -> None:
    recording.set_time(STEP_TIMELINE, sequence=step)
    recording.set_time(TIME_TIMELINE, duration=step * log.info.control_dt)


def layout(cameras: tuple[str, ...], *, devices: bool = False) -> Any:
    """The arrangement of views: the scene, the cameras' pictures, and the curves, also of two devices."""
    rerun_module()
    import rerun.blueprint as rrb

    pictures = [rrb.Spatial2DView(origin=f"world/camera/{name}", name=name) for name in cameras]
    labels = CURVES | ({name: label for name, (_, label) in DEVICE_CURVES.items()} if devices else {})
    curves = [rrb.TimeSeriesView(origin=f"curves/{name}", name=label) for name, label in labels.items()]
    eye = rrb.EyeControls3D(position=(0.0, -EYE_DISTANCE, 0.05), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0))
    scene = rrb.Spatial3DView(
        origin="world", name="aorta and devices" if devices else "aorta and wire", eye_controls=eye
    )
    right = rrb.Vertical(*pictures, rrb.TextDocumentView(origin="episode", name="episode"))
    above = rrb.Horizontal(scene, right, column_shares=[2, 1])
    views = rrb.Vertical(above, rrb.Grid(*curves, grid_columns=min(len(curves), 5)), row_shares=[3, 1])
    return rrb.Blueprint(views, rrb.TimePanel(timeline=TIME_TIMELINE, state="collapsed"), collapse_panels=True)


def save_recording(path: Path, destination: Path) -> Path:
    """Writes an episode as a Rerun recording (.rrd), in place of one that is there; it appears when it is whole."""
    rr = rerun_module()
    try:
        with atomic_path(destination) as partial, EpisodeReader(path) as log:
            partial.touch()
            # the same episode is the same recording, however often it is opened
            identity = f"{log.info.phantom}-{log.info.target}-{log.info.seed}-{log.info.start_time_ns}"
            recording = rr.RecordingStream(APPLICATION, recording_id=identity)
            recording.set_log_time_enabled(False)
            recording.set_log_tick_enabled(False)
            recording.save(partial, default_blueprint=layout(log.cameras, devices=log.info.has_catheter))
            recording.send_recording_name(path.stem)
            try:
                log_episode(log, recording)
            finally:
                recording.flush()
                recording.disconnect()
    except OSError as error:
        raise ViewerError(f"cannot write {destination}: {error.strerror}; choose another file") from error
    return destination


def show_episode(path: Path) -> None:
    """Opens an episode in the Rerun viewer and waits until it is closed; a ViewerError if it opens no window."""
    rerun_module()
    with tempfile.TemporaryDirectory(prefix="endonav-") as folder:
        recording = save_recording(path, Path(folder) / f"{path.stem}.rrd")
        # of itself the viewer would listen on all interfaces
        command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", "--port", "auto", str(recording)]
        code = subprocess.run(command, check=False).returncode
    if code:
        raise ViewerError(
            f"the Rerun viewer ended with code {code}: where there is no screen, use --save OUT.rrd and open that "
            "elsewhere"
        )
