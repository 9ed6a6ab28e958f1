"""The demo's film: every panel shows the moment, and what the policy reads is drawn on the view that it sees."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.demo.film import LUMEN, STRIDE, TARGET, TITLE_PX, TRUE_WIRE, VIEW_PX, WAY, WIRE, DemoFilm
from pipeline.demo.page import plot, sections
from pipeline.demo.steering import Scene, open_scene
from tests.pipeline.demo.small_policies import ship


def shows(panel: np.ndarray, colour: tuple[int, int, int]) -> bool:
    """Whether some pixels have nearly a colour."""
    return bool((np.abs(panel.astype(int) - colour).max(axis=2) < 40).any())


def find_everything(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Has the scene's perception find a wire and a lumen in any image."""
    perception = scene.policy.perception  # type: ignore[union-attr]
    mask, lumen = np.zeros((len(perception.cameras), 64, 64), np.uint8), np.zeros((64, 64), np.float32)
    mask[:, 40:, 32], lumen[:, 20:44] = 255, 1.0
    monkeypatch.setattr(perception, "mask", lambda seen: mask)
    monkeypatch.setattr(perception.segmenter, "lumen", lambda image: lumen)


def test_a_film_that_the_disk_has_no_room_for_is_refused_and_the_last_one_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ship(tmp_path, monkeypatch)
    film = DemoFilm(open_scene("generalist", seed=2))
    film._frames = [np.full((64, 64, 3), level, np.uint8) for level in (10, 200)]
    film.write_mp4(tmp_path / "film.mp4")
    before = (tmp_path / "film.mp4").read_bytes()

    def cut_off(path: str, size: tuple[int, int], **given: Any) -> Any:
        while True:
            yield
            Path(path).write_bytes(before[: len(before) // 2])

    monkeypatch.setattr("imageio_ffmpeg.write_frames", cut_off)
    with pytest.raises(OSError, match=r"film\.mp4 could not be written whole: is there room on the disk"):
        film.write_mp4(tmp_path / "film.mp4")
    assert (tmp_path / "film.mp4").read_bytes() == before
    assert not list(tmp_path.glob(".tmp*"))
    film.close()


@pytest.mark.parametrize("model", ["navigator", "generalist"])
def test_panels_show_what_is_read(model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ship(tmp_path, monkeypatch)
    scene = open_scene(model, seed=2)
    film = DemoFilm(scene)
    environment = scene.environment
    by_images = model == "navigator"
    if by_images:  # an untrained network finds neither wire nor lumen
        find_everything(scene, monkeypatch)
    observation, info = environment.reset(seed=scene.start_seed)
    film.add(environment)
    for _ in range(STRIDE):
        observation, _, _, _, info = environment.step(scene.steer(observation, info))
        film.add(environment)
    first, last = film._frames
    frontal, lateral = (panel[TITLE_PX:] for panel in (last[:, :VIEW_PX], last[:, VIEW_PX : 2 * VIEW_PX]))
    assert all(shows(frontal, colour) for colour in (TARGET, WAY, WIRE))
    assert all(shows(lateral, colour) for colour in (TARGET, TRUE_WIRE))
    assert shows(lateral, WIRE) is not by_images
    assert shows(frontal, LUMEN) is by_images
    assert first.shape == last.shape
    assert (first != last).any()
    assert {name: len(values) for name, values in film.curves.items()} == dict.fromkeys(
        ("distance_mm", "force_n"), STRIDE + 1
    )
    assert 10 < film.curves["distance_mm"][0] < 500
    film.close()
    environment.close()


def test_both_views_show_what_a_policy_of_two_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ship(tmp_path, monkeypatch, ("lao_45", "frontal"))
    scene = open_scene("navigator", seed=2)
    film, environment = DemoFilm(scene), scene.environment
    find_everything(scene, monkeypatch)
    observation, info = environment.reset(seed=scene.start_seed)
    environment.step(scene.steer(observation, info))
    film.add(environment)
    assert film.views == ("lao_45", "frontal")
    (frame,) = film._frames
    for panel in (frame[TITLE_PX:, :VIEW_PX], frame[TITLE_PX:, VIEW_PX : 2 * VIEW_PX]):
        assert all(shows(panel, colour) for colour in (LUMEN, WAY, WIRE, TARGET))
    film.close()
    environment.close()


def test_a_catheter_is_in_the_views_for_people() -> None:
    scene = open_scene("generalist", seed=247, target="lcca")  # set back by 11 mm
    assert scene.model == "generalist_jb2"
    film, environment = DemoFilm(scene), scene.environment
    observation, info = environment.reset(seed=scene.start_seed)
    before = film._xray(environment, "frontal")
    for _ in range(20):
        observation, _, _, _, info = environment.step(scene.steer(observation, info))
    assert environment.simulation.pair.both
    assert (film._xray(environment, "frontal").astype(int) < before.astype(int) - 20).any()
    film.add(environment)
    assert len(film._frames) == 1
    film.close()
    environment.close()


def test_parts_of_a_card_are_plain_text() -> None:
    head = "# a\n\nSteers.\n\n| file |\n|---|\n\n**What it sees.** The `image`\nalone.\n\n**Command.** None.\n\n"
    card = f"{head}**Figures.** Some.\n\n| x |\n\n**Limits.** Many,\n\n```bash\nmake demo\n```\n"
    assert sections(card) == {"What it sees": "The image alone.", "Limits": "Many, make demo"}


def test_a_plot_spans_its_width_and_height() -> None:
    assert plot([0.0, 2.0, 1.0]) == "0.0,120.0 245.0,0.0 490.0,60.0"
    assert plot([0.0]) == "0.0,120.0"
