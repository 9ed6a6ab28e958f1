"""Every range of seeds that the pipeline uses: of random arches, of copies of an anatomy, and of episodes' resets.

Ranges of one table never meet, whatever run seed is allowed, so nothing is tested on what it learnt from or was chosen
by. A range belongs to one purpose. Most are cut into equal parts, one for each run seed or training seed.

`RETIRED_ARCHES` and `RETIRED_EPISODES` were looked at while something was chosen: nothing is tested there any more.
Environments and trainings also draw seeds of their own, all below 2**32: starts that are tested begin above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.store.errors import ConfigurationError


@dataclass(frozen=True)
class SeedRange:
    """Seeds of one purpose."""

    first: int  # of all of them
    width: int  # how many a part has
    parts: int  # one for each run seed or training seed; 1: all share them
    of: str  # what a seed stands for, for messages

    @property
    def all(self) -> range:
        """Every seed of the purpose."""
        return range(self.first, self.first + self.width * self.parts)

    def part(self, seed: int, count: int, *, skip: int = 0) -> range:
        """So many seeds of the part of a run or training, but the first `skip`."""
        if not 0 <= seed < self.parts:
            raise ConfigurationError(
                f"seed {seed} has no {self.of} of its own, only seeds 0 to {self.parts - 1} have: choose a "
                "smaller seed of the run"
            )
        if skip + count > self.width:
            raise ConfigurationError(f"a seed has {self.width} {self.of} of its own, got {skip + count}: choose fewer")
        start = self.first + seed * self.width + skip
        return range(start, start + count)


_RUNS, _TRAININGS = 20, 500  # run seeds of stages with random arches; seeds of trainings

ARCHES = {
    "training": SeedRange(0, 1_000, _RUNS, "training arches"),
    "perception": SeedRange(20_000, 500, _RUNS, "arches for the SplineFormer"),
    "validation": SeedRange(32_000, 1_000, 1, "validation arches"),
    "test": SeedRange(40_000, 1_000, 1, "test arches"),
    "protocol": SeedRange(600_000, 1_000, 120, "arches of the protocol"),
}
RETIRED_ARCHES = range(30_000, 32_000), range(33_000, 34_000)

EPISODES = {
    "sampling expert": SeedRange(0, 1_000, _TRAININGS, "demonstrations"),
    # enn.reinforcement.evaluation counts seeds in the same way.
    "evaluation while training": SeedRange(500_000, 1_000, _TRAININGS, "evaluations"),
    "expert": SeedRange(2_000_000, 1_000, _TRAININGS, "expert episodes"),
    "disturbed expert": SeedRange(2_500_000, 1_000, _TRAININGS, "disturbed expert episodes"),
    "navigation, expert goes on": SeedRange(3_000_000, 1_000, _TRAININGS, "further expert episodes"),
    "navigation, advised": SeedRange(4_000_000, 1_000_000, _RUNS, "advised episodes of navigation"),
    "force": SeedRange(30_000_000, 100_000, _TRAININGS, "episodes with forces"),
    "unseen, advised": SeedRange(100_000_000, 10_000_000, _RUNS, "advised episodes in random arches"),
    "unseen, demonstrations": SeedRange(300_000_000, 1_000, _RUNS, "demonstrations in random arches"),
    "rehearsal, demonstrations": SeedRange(400_000_000, 100_000, _TRAININGS, "demonstrations in copies"),
    "rehearsal, trials of devices": SeedRange(500_000_000, 1_000, _TRAININGS, "trials of devices in copies"),
    "test": SeedRange(5_000_000_000, 1_000, _TRAININGS, "test episodes"),
    "protocol": SeedRange(7_000_000_000, 10, 120_000, "starts of the protocol"),  # a part for each arch
}
RETIRED_EPISODES = (range(1_000_000, 2_000_000),)

ANATOMY_COPIES = {  # of an anatomy, as cathsim.rehearsal draws them; 0 is the anatomy itself
    "training": SeedRange(1, 1_000, _TRAININGS, "copies to train in"),
    "validation": SeedRange(1_000_001, 1_000, 1, "validation copies"),
    "test": SeedRange(2_000_001, 1_000, 1, "test copies"),
}

# Seeds of a purpose, by the seed of the run or training and their number.
training_arches = ARCHES["training"].part  # of the random arches that a run trains in
perception_arches = ARCHES["perception"].part  # that show the SplineFormer their wires; no policy learns there
demonstration_seeds = EPISODES["sampling expert"].part  # of the episodes that others learn from
# Seeds of a training's test episodes; nothing else is trained or chosen on them.
held_out_seeds = EPISODES["test"].part
expert_seeds = EPISODES["expert"].part  # of a training's episodes with images, which imitation learns from
disturbed_seeds = EPISODES["disturbed expert"].part  # ... with disturbed actions
# Seeds of episodes that an expert plays for a navigator where its logs are too few.
further_expert_seeds = EPISODES["navigation, expert goes on"].part
training_copies = ANATOMY_COPIES["training"].part  # of an anatomy, that a rehearsal trains in

_COPIES = 2_000  # seeds of a round of demonstrations in copies
_ROUND, _COURSE = 10_000, 1_000  # seeds of a round of a navigator's advised episodes, of a course in it
_UNSEEN_ROUND = 100_000  # ... of a round of an image policy's


def validation_arches(count: int, every: int = 2) -> range:
    """Seeds of the arches that choose the best policy: by default even ones; with `every` = 1 of all types by turns."""
    return ARCHES["validation"].part(0, every * count)[::every]


def unseen_arches(count: int) -> range:
    """Seeds of the random arches of the tests, the same for every run."""
    return ARCHES["test"].part(0, count)


def protocol_arches(first: int, seed: int, count: int) -> range:
    """Seeds of the random arches of a claim whose first one is `first`; each seed of the evaluation has its own."""
    block = ARCHES["protocol"]
    return block.part((first - block.first) // block.width + seed, count)


def protocol_start(arch: int, target: int) -> int:
    """Seed of an episode's start in an arch of the protocol, towards the target of a number."""
    return EPISODES["protocol"].part(arch - ARCHES["protocol"].first, 1, skip=target)[0]


def force_seed(seed: int, episode: int) -> int:
    """Seed of an episode that is recorded for the prediction of forces."""
    return EPISODES["force"].part(seed, 1, skip=episode)[0]


def navigation_episode_seeds(run_seed: int, number: int, course: int, count: int) -> range:
    """Seeds of the advised episodes of a round and a course, from 0, of a navigator."""
    if count > _COURSE or course >= _ROUND // _COURSE:
        raise ConfigurationError(
            f"a round has up to {_ROUND // _COURSE} courses of up to {_COURSE} episodes, got {count} in number "
            f"{course + 1}: choose fewer"
        )
    return EPISODES["navigation, advised"].part(run_seed, count, skip=number * _ROUND + course * _COURSE)


def unseen_episode_seeds(run_seed: int, number: int, count: int) -> range:
    """Seeds of the advised episodes of a round, from 0, of an image policy."""
    if count > _UNSEEN_ROUND:
        raise ConfigurationError(f"a round has up to {_UNSEEN_ROUND} episodes, got {count}: choose fewer")
    return EPISODES["unseen, advised"].part(run_seed, count, skip=number * _UNSEEN_ROUND)


def arch_demonstration_seed(run_seed: int) -> int:
    """Seed of the start of demonstrations in random arches; each is played in an arch of its own."""
    return EPISODES["unseen, demonstrations"].part(run_seed, 1)[0]


def rehearsal_demonstration_seed(training_seed: int, number: int, case: int) -> int:
    """Seed of a demonstration in a round, in a copy by its number among those of the training, both from 0."""
    return EPISODES["rehearsal, demonstrations"].part(training_seed, 1, skip=number * _COPIES + case)[0]


def device_trial_seed(training_seed: int) -> int:
    """Seed of the first episode that is played with each of several devices, to choose among them."""
    return EPISODES["rehearsal, trials of devices"].part(training_seed, 1)[0]


def validation_copies(count: int) -> range:
    """Seeds of the perturbed copies that choose a rehearsal's best policy."""
    return ANATOMY_COPIES["validation"].part(0, count)


def held_out_copies(count: int) -> range:
    """Seeds of the perturbed copies in which rehearsals are tested, the same for every run."""
    return ANATOMY_COPIES["test"].part(0, count)


def acquisition_seed(run_seed: int, number: int) -> int:
    """Seed of all that an acquisition of the generated bi-planar data set draws; hashed, so it has no range."""
    return int(np.random.SeedSequence((run_seed, number)).generate_state(1)[0])
