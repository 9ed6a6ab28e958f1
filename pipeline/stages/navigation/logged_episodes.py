"""Logged episodes of an expert as the navigator would have seen them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.episodes import EpisodeReader
from pipeline.recording.replay import checked_values, recorded_phantom
from pipeline.stages.navigation.scene import view_of

if TYPE_CHECKING:
    from cathsim.observations.c_arm_view import CArms
    from enn.imitation.sequence_cloning import AdvisedEpisode
    from splineformer.navigation.navigator_perception import NavigatorPerception


def episode_of_log(log: Path, arms: CArms, perception: NavigatorPerception, action_repeat: int) -> AdvisedEpisode:
    """An expert's logged episode as the navigator would have seen it, an image a decision.

    Args:
        log: of an episode that a feeder steered.
        arms: of the images, which are drawn from the logged shapes of the wire.

    Raises:
        EpisodeReadError: the log is damaged or unfinished.
    """
    from cathsim.observations.c_arm_view import images_of_shape, with_shaft
    from enn.imitation.sequence_cloning import AdvisedEpisode

    with EpisodeReader(log) as episode:
        info, outcome = episode.info, episode.outcome
        arrays = episode.load_arrays(pictures=False)
    with checked_values(info, "phantom"):
        phantom = recorded_phantom(info)
    direction = phantom.entry(info.entry).direction
    steps = range(0, len(arrays["action"]) - 1, action_repeat)
    images = [
        images_of_shape(phantom, arms, with_shaft(arrays["wire_points"][step], direction), (info.seed, step))
        for step in steps
    ]
    readings = perception.network([image for several in images for image in several])
    count = len(arms.cameras)
    view = view_of(perception.settings, phantom, info.target, arms, list)
    features, actions = [], [np.zeros(2, np.float32)]
    for number, step in enumerate(steps):
        features.append(view.look(readings[number * count : (number + 1) * count], actions[-1]))
        # what the expert did while a decision of the navigator would have been held
        done = arrays["action"][step + 1 : step + 1 + action_repeat]
        actions.append(done.mean(axis=0).astype(np.float32))
    nothing = np.zeros((len(features), 0), np.float32)
    return AdvisedEpisode(np.stack(features), np.stack(actions[1:]), nothing, bool(outcome.success), info.target)
