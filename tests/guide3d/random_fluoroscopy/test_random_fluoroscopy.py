"""Random fluoroscopy: tiles, strokes, courses, backgrounds, its command."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from guide3d.dataset.dataset import Dataset
from guide3d.random_fluoroscopy.__main__ import RECORD, main
from guide3d.random_fluoroscopy.anatomy import ANATOMY, projected_ct
from guide3d.random_fluoroscopy.canvas import Canvas
from guide3d.random_fluoroscopy.courses import STEP_PX, walk, wire_course
from guide3d.random_fluoroscopy.phantom_clutter import PHANTOM_CLUTTER
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.random_fluoroscopy.small_marks import SMALL_MARKS
from tests.guide3d.learning.drawn_data import SIDE, draw

PLAIN = FluoroscopySettings(
    no_wire=0.0, two_devices=0.0, catheter=0.0, along_edge=0.0, in_vessel=0.0, tip_change=0.0, beads=0.0, markers=0.0,
    clutter=1e-6, anatomy=0.0, contrast=0.0, field=0.0, noise=0.31, jpeg=0.0, narrowest_px=3.0, weakest=0.65,
)  # fmt: skip


def test_seed_and_index_give_the_same_pixels() -> None:
    first, second = RandomFluoroscopy(seed=7).tile(5, 96), RandomFluoroscopy(seed=7).tile(5, 96)
    for name in ("image", "wire", "catheter", "tip", "tips"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.kinds == second.kinds
    assert not np.array_equal(first.image, RandomFluoroscopy(seed=8).tile(5, 96).image)
    assert not np.array_equal(first.image, RandomFluoroscopy(seed=7).tile(6, 96).image)


SITUATIONS = (
    "no wire", "two wires", "loop", "hairpin", "bent tip", "angled tip", "folded tip", "curled tip", "changed tip",
    "markers", "beads on the wire", "tip on a dark vessel", "wire along an edge", "wire in a vessel",
    "contrast vessels", "catheter over the wire", "catheter beside the wire", "catheter alone", "round field",
    "square field", "octagon field", "collimated field", "open field",
)  # fmt: skip


def test_all_clutter_and_all_situations_occur() -> None:
    fluoroscopy = RandomFluoroscopy(seed=3)
    drawn = [fluoroscopy.tile(index, 128).kinds for index in range(120)]
    assert not [kind for kind in (*PHANTOM_CLUTTER, *SMALL_MARKS, *ANATOMY) if not any(kind in one for one in drawn)]
    shares = {kind: np.mean([kind in one for one in drawn]) for kind in SITUATIONS}
    assert not {kind: share for kind, share in shares.items() if not 0 < share < 0.9}


def test_the_mask_lies_on_the_dark_wire() -> None:
    fluoroscopy = RandomFluoroscopy(PLAIN, seed=1)
    for index in range(6):
        drawn = fluoroscopy.tile(index, 192)
        on = drawn.wire > 200
        if on.sum() < 200:
            continue
        away = drawn.wire == 0
        (line,) = (piece for pieces in drawn.wires for piece in pieces[:1])
        x, y = np.clip(np.rint(line).astype(int), 0, 191).T
        assert np.median(drawn.image[y, x]) < 0.9 * np.median(drawn.image[away])
        assert (drawn.wire[y, x] > 127).mean() > 0.98


@pytest.mark.parametrize("columns", [2, 3])
def test_given_courses_are_followed(columns: int) -> None:
    along = np.linspace(0, 1, 80)[:, None]
    curve = np.hstack((150 * along, 40 * np.sin(4 * along), 20 * along))[:, :columns]
    fluoroscopy = RandomFluoroscopy(replace(PLAIN, given_course=1.0), seed=0, courses=[curve])
    kinds = set().union(*(fluoroscopy.tile(index, 64).kinds for index in range(4)))
    assert "given course" in kinds


def test_clutter_alone_has_no_device_and_means_what_passes() -> None:
    fluoroscopy = RandomFluoroscopy(replace(PLAIN, clutter=1.0, anatomy=0.5), seed=2)
    whole, small = fluoroscopy.clutter(4), fluoroscopy.clutter(4, 128)
    assert (whole.shape, small.shape, small.dtype) == ((1024, 1024), (128, 128), np.float32)
    np.testing.assert_array_equal(
        small, RandomFluoroscopy(replace(fluoroscopy.settings, no_wire=1.0), 2).clutter(4, 128)
    )
    passed = np.exp(-whole).reshape(128, 8, 128, 8).mean((1, 3))
    np.testing.assert_allclose(np.exp(-small), passed, atol=1e-5)
    assert whole.std() > 0.02
    assert not np.array_equal(small, fluoroscopy.clutter(5, 128))
    assert RandomFluoroscopy(PLAIN, seed=2).clutter(4).std() < 0.5 * whole.std()


LINE = np.array([[5.0, 20.0], [60.0, 20.0]])


def test_a_stroke_has_its_width_and_attenuation() -> None:
    for width in (1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 12.0):
        canvas = Canvas(0, 0, 64, 48)
        canvas.stroke(LINE, width, 0.5)
        across = canvas.attenuation[:, 30]
        assert width < 2 or abs(across.max() - 0.5) < 0.01
        assert abs(across.sum() / 0.5 - width) < (0.4 if width < 8 else 1.4)
        assert abs((across * np.arange(48)).sum() / across.sum() - 20.0) < 0.1


def test_a_walk_has_equal_steps_and_its_bend() -> None:
    points = walk(np.random.default_rng(0), np.array([10.0, 20.0]), 0.0, 600.0, 1 / 100, 60.0, 2.0)
    steps = np.diff(points, axis=0)
    np.testing.assert_allclose(np.hypot(*steps.T), 2.0, atol=1e-9)
    turns = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    assert 0.2 / 100 < np.std(turns) / 2.0 < 3 / 100


def test_wires_start_inside_and_leave_the_image() -> None:
    rng = np.random.default_rng(1)
    left = 0
    for _ in range(40):
        course, _ = wire_course(rng, 1024)
        assert (course[0] > 0).all()
        assert (course[0] < 1024).all()
        np.testing.assert_allclose(np.hypot(*np.diff(course, axis=0).T), STEP_PX, atol=1e-9)
        left += bool((course[-1] < 0).any() or (course[-1] > 1024).any())
    assert left > 30


def phantom() -> np.ndarray:
    """A body of water with a bone and a bubble."""
    z, y, x = np.mgrid[:20, :60, :60]
    body = np.full((20, 60, 60), -1000.0)
    body[(x - 30) ** 2 + (y - 30) ** 2 < 25**2] = 0.0
    body[(x - 20) ** 2 + (y - 30) ** 2 < 16] = 1000.0
    body[(x - 40) ** 2 + (y - 30) ** 2 + (2 * (z - 10)) ** 2 < 36] = -1000.0
    return body


def test_bone_is_darker_and_gas_brighter() -> None:
    image = projected_ct(phantom(), (2.0, 1.0, 1.0), 0.0)
    assert image.shape[0] == 40
    middle = image[20]
    left = image.shape[1] // 2
    bone, gas = middle[left - 12 : left - 7].mean(), middle[left + 8 : left + 13].mean()
    assert bone > image[4][left + 8 : left + 13].mean() > gas  # where there is no gas, there is water


CLEAN = '{"clutter": 1e-6, "catheter": 0, "along_edge": 0, "in_vessel": 0, "narrowest_px": 4.0, "noise": 0.31}'


def test_images_lie_along_the_annotation(tmp_path: Path) -> None:
    draw(tmp_path / "data", acquisitions=2, frames=2)
    assert main([str(tmp_path / "data"), "--output", str(tmp_path / "new"), "--settings", CLEAN]) == 0
    data = Dataset.open(tmp_path / "data", images=tmp_path / "new")
    darker = []
    for frame in data.frames:
        for camera in "ab":
            image = frame.image(camera)
            assert image.shape == (SIDE, SIDE)
            line = frame.polyline(camera)
            line = line[((line > 1) & (line < SIDE - 2)).all(axis=1)]
            x, y = np.rint(line).astype(int).T
            around = [image[np.clip(y + d, 0, SIDE - 1), np.clip(x + e, 0, SIDE - 1)] for d, e in ((4, 0), (0, 4))]
            darker.append(np.median(image[y, x].astype(float) / np.maximum(np.max(around, axis=0), 1)))
    assert np.median(darker) < 0.97


def test_bad_settings_are_refused_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    draw(tmp_path / "data", acquisitions=1, frames=1)
    words = [str(tmp_path / "data"), "--output", str(tmp_path / "new"), "--settings"]
    assert main([*words, '{"noise": -3}']) == 2
    assert "noise" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main([*words, "[1]"])
    assert "expected a JSON object of fields" in capsys.readouterr().err
    assert main([*words, '{"noises": 3}']) == 2
    assert "'noises' is unknown" in capsys.readouterr().err


def test_a_second_run_keeps_what_is_there_and_mixes_no_other_images(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    draw(tmp_path / "data", acquisitions=1, frames=2)
    words = [str(tmp_path / "data"), "--output", str(tmp_path / "new"), "--frames", "1", "--settings", CLEAN]
    assert main(words) == 0
    (first, second) = sorted((tmp_path / "new").rglob("*.png"))
    before = first.stat().st_mtime_ns, second.read_bytes()
    second.unlink()
    assert main(words) == 0
    assert (first.stat().st_mtime_ns, second.read_bytes()) == before
    assert main([*words, "--seed", "1"]) == 2
    assert "holds images of another seed" in capsys.readouterr().err
    (tmp_path / "new" / RECORD).unlink()
    assert main(words) == 2
    assert "not of random fluoroscopy" in capsys.readouterr().err
