"""Ranges of seeds: none meets another, no module has one of its own, and nothing is tested where it was looked at."""

import ast
import itertools
import re
from pathlib import Path

import pytest

from pipeline import seeds
from pipeline.store.errors import ConfigurationError

PIPELINE = Path(seeds.__file__).parent
_SEED = re.compile(r"seed|arch|anatom", re.IGNORECASE)
_SMALL = 100  # numbers from here on begin or divide a range; a module may well count seeds


@pytest.mark.parametrize(
    ("table", "retired"),
    [(seeds.ARCHES, seeds.RETIRED_ARCHES), (seeds.EPISODES, seeds.RETIRED_EPISODES), (seeds.ANATOMY_COPIES, ())],
)
def test_ranges_are_disjoint_for_every_seed(table: dict[str, seeds.SeedRange], retired: tuple[range, ...]) -> None:
    every = {name: one.all for name, one in table.items()}
    for (one, first), (other, second) in itertools.combinations(every.items(), 2):
        assert first.stop <= second.start or second.stop <= first.start, (one, other)
    for gone in retired:
        assert all(gone.stop <= one.start or one.stop <= gone.start for one in every.values())
    for name, one in table.items():
        parts = [one.part(seed, one.width) for seed in range(one.parts)]
        assert all(before.stop <= after.start for before, after in itertools.pairwise(parts)), name
        assert (parts[0].start, parts[-1].stop) == (one.all.start, one.all.stop)


def test_what_functions_give_lies_in_their_range() -> None:
    run, training = 19, 499
    advised = [seeds.unseen_episode_seeds(run, number, 100_000) for number in (0, 99)]
    courses = [seeds.navigation_episode_seeds(run, number, 9, 1_000) for number in (0, 99)]
    given = {
        "training": [seeds.training_arches(run, 1_000)],
        "perception": [seeds.perception_arches(run, 500)],
        "validation": [seeds.validation_arches(500)],
        "test": [seeds.unseen_arches(1_000)],
        "protocol": [seeds.protocol_arches(600_000, 119, 1_000), seeds.protocol_arches(690_000, 2, 1_000)],
    }
    for name, several in given.items():
        assert all(set(one) <= set(seeds.ARCHES[name].all) for one in several)
    copies = {
        "training": seeds.training_copies(training, 1_000),
        "validation": seeds.validation_copies(1_000),
        "test": seeds.held_out_copies(1_000),
    }
    assert all(set(one) <= set(seeds.ANATOMY_COPIES[name].all) for name, one in copies.items())
    episodes = {
        "sampling expert": [seeds.demonstration_seeds(training, 1_000)],
        "expert": [seeds.expert_seeds(training, 1_000)],
        "disturbed expert": [seeds.disturbed_seeds(training, 1_000)],
        "navigation, expert goes on": [seeds.further_expert_seeds(training, 1_000)],
        "navigation, advised": courses,
        "force": [(seeds.force_seed(training, 0), seeds.force_seed(training, 99_999))],
        "unseen, advised": advised,
        "unseen, demonstrations": [(seeds.arch_demonstration_seed(run),)],
        "rehearsal, trials of devices": [(seeds.device_trial_seed(training),)],
        "rehearsal, demonstrations": [
            [seeds.rehearsal_demonstration_seed(training, *last) for last in ((0, 0), (49, 1_999))]
        ],
        "test": [seeds.held_out_seeds(training, 1_000)],
        "protocol": [(seeds.protocol_start(600_000, 0), seeds.protocol_start(719_999, 9))],
    }
    for name, several in episodes.items():
        whole = seeds.EPISODES[name].all
        assert all(one[0] in whole and one[-1] in whole for one in several), name
    assert set(episodes) == set(seeds.EPISODES) - {"evaluation while training"}
    assert seeds.EPISODES["test"].first >= 2**32  # none that a generator draws


def test_evaluations_while_training_are_those_of_enn() -> None:
    from enn.reinforcement.evaluation import BestPolicy

    known = seeds.EPISODES["evaluation while training"]
    for seed in (0, 3, 499):
        assert BestPolicy(1_000, seed).seeds == known.part(seed, 1_000)


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        (lambda: seeds.training_arches(20, 1), "seed 20 has no training arches of its own, only seeds 0 to 19"),
        (lambda: seeds.held_out_seeds(0, 1_001), "a seed has 1000 test episodes of its own, got 1001"),
        (lambda: seeds.navigation_episode_seeds(0, 0, 0, 1_001), "up to 1000 episodes, got 1001"),
        (lambda: seeds.navigation_episode_seeds(0, 100, 0, 1), "1000000 advised episodes of navigation"),
        (lambda: seeds.unseen_episode_seeds(0, 0, 100_001), "up to 100000 episodes, got 100001"),
    ],
)
def test_too_large_a_seed_or_too_many_is_one_sentence(asked, sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=sentence):
        asked()


def _own_ranges(source: str) -> list[str]:
    """Lines that begin or divide a range of seeds: a large number beside a name of seeds, arches or anatomies."""
    tree = ast.parse(source)
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.BinOp | ast.Assign) or (
            isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "range"
        ):
            inner = list(ast.walk(node))
            names = [part.id if isinstance(part, ast.Name) else part.attr for part in inner
                     if isinstance(part, ast.Name | ast.Attribute)]  # fmt: skip
            large = [part.value for part in inner if isinstance(part, ast.Constant) and type(part.value) is int
                     and part.value >= _SMALL]  # fmt: skip
            shallow = isinstance(node, ast.Assign) and not isinstance(node.value, ast.Constant | ast.BinOp | ast.Tuple)
            if large and not shallow and any(_SEED.search(name) for name in names):
                found.append(ast.unparse(node))
    return found


def test_every_acquisition_of_every_run_has_a_seed_of_its_own() -> None:
    every = {seeds.acquisition_seed(run, number) for run in range(4) for number in range(1, 500)}
    assert len(every) == 4 * 499


def test_no_other_module_has_a_range_of_its_own() -> None:
    others = [path for path in PIPELINE.rglob("*.py") if path != Path(seeds.__file__)]
    assert len(others) > 100
    assert {path.name: lines for path in others if (lines := _own_ranges(path.read_text(encoding="utf-8")))} == {}
