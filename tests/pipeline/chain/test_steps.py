"""Steps of a chain: seeds, what they wait for, and whose settings are whose."""

from __future__ import annotations

from pipeline.chain import Step, concerns, steps_of, steps_to_the_end, waits_for
from pipeline.stages import available_stages


def test_settings_concern_the_stages_that_have_them() -> None:
    assert concerns("stage.device=cuda", "enn")
    assert not concerns("stage.device=cuda", "phantoms")
    assert concerns("++stage.task.max_steps=5", "expert")
    assert not concerns("stage.task.max_steps=5", "shape")
    assert concerns("stage@enn.decisions=5", "enn")
    assert not concerns("stage@enn.decisions=5", "baselines")
    assert not concerns("stage@enn.nothing=5", "enn")
    assert concerns("budget=smoke", "phantoms")


def test_several_seeds_repeat_the_stages_whose_figures_depend_on_them() -> None:
    steps = steps_of(["phantoms", "shape", "report"], 3)
    assert list(map(str, steps)) == ["phantoms", "shape", "shape with seed 1", "shape with seed 2", "report"]
    assert steps_of(["shape"], 1) == [Step("shape")]
    repeated = [step.stage for step in steps_of(available_stages(), 2) if step.seed == 1]
    assert repeated == ["imitation", "force", "unseen", "shape", "splineformer", "navigation"]


def test_a_step_waits_for_what_it_reads_and_the_report_for_all() -> None:
    steps = steps_of(
        ["phantoms", "guide3d", "segmentation", "shape", "splineformer", "unseen", "rehearsal", "report"], 2
    )
    needs = {str(step): [str(steps[k]) for k in waits_for(steps, place)] for place, step in enumerate(steps)}
    assert needs["guide3d"] == []
    assert needs["shape with seed 1"] == ["guide3d"]
    assert needs["splineformer"] == ["guide3d", "segmentation"]
    assert needs["rehearsal"] == ["unseen", "unseen with seed 1"]
    assert needs["report"] == list(needs)[:-1]


def test_the_longest_chain_of_steps_that_wait_for_each_other() -> None:
    steps = [Step("phantoms"), Step("expert"), Step("enn"), Step("guide3d"), Step("shape"), Step("report")]
    assert steps_to_the_end(steps) == [4, 3, 2, 3, 2, 1]
    # the same stage with other seeds is not waited for
    assert steps_to_the_end([Step("shape"), Step("shape", 1)]) == [1, 1]
