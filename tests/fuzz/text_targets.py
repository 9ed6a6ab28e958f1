"""What people and pages write: settings on the command line and messages of the console, drawn by hypothesis."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hypothesis
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hypothesis import HealthCheck, Phase, given
from hypothesis import strategies as st
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from cathsim.console.controls import Controls
from cathsim.console.questionnaire import check_answers
from cathsim.console.web.requests import KINDS, LONGEST_REQUEST, read_request
from pipeline.config import run_config
from pipeline.explain import one_line
from pipeline.stages import available_stages, load_stage
from pipeline.store.errors import PipelineError
from tests.fuzz.mutations import NASTY
from tests.fuzz.target import Target, WrongError, refused
from tests.pipeline.composed import unchecked

_FIELDS = ("advance", "rotate", "sequence", "catheter", "phantom", "target", "answers", "more")
EXAMPLES = 25  # of a seed
SETTINGS = {name: load_stage(name).settings for name in available_stages()}
_PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20) | st.sampled_from(NASTY[:20]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


def try_examples(strategy: st.SearchStrategy[Any], check: Callable[[Any], None], seed: int) -> None:
    """Checks what hypothesis draws with a seed; a failure is made small before it is raised."""

    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=EXAMPLES, database=None, deadline=None, phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck), print_blob=False,
    )  # fmt: skip
    @given(strategy)
    def each(example: Any) -> None:
        check(example)

    each()


class SettingsTarget(Target):
    """Overrides of every stage, from the command line's grammar to the checked dataclasses."""

    name = "settings"
    seconds = 10.0  # for all examples of a seed

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.composed = {name: unchecked(f"stage={name}") for name in SETTINGS}
        keys = {
            name: [f"stage.{f.name}" for f in dataclasses.fields(settings)]  # type: ignore[arg-type]
            + ["name", "seed", "runs_dir", "target", "modality", "phantom.name", "phantom.names", "force", "stage.none"]
            for name, settings in SETTINGS.items()
        }
        words = st.sampled_from(("nan", "-inf", "1e300", "-1", "0", "1e-9", "[1,2]", "{a: 1}", "null", "../x", "'a b'",
                                 "[[]]", "true", "9" * 400, "[nan]", "${seed}", "${nothing}", "${oc.env:HOME}", "a,b",
                                 "range(1,3)", "x" * 300))  # fmt: skip
        numbers = st.integers().map(str) | st.floats().map(str)
        values = (
            words
            | numbers
            | st.text(max_size=12)
            | st.lists(words | numbers, max_size=3).map(lambda parts: f"[{','.join(parts)}]")
        )
        self.overrides = st.sampled_from(sorted(SETTINGS)).flatmap(
            lambda stage: st.tuples(
                st.just(stage), st.lists(st.tuples(st.sampled_from(keys[stage]), values), min_size=1, max_size=3)
            )
        )

    def run(self, seed: int) -> None:
        try_examples(self.overrides, self._check, seed)

    def _check(self, example: tuple[str, list[tuple[str, str]]]) -> None:
        stage, pairs = example
        config = self.composed[stage].copy()
        overrides = [f"{key}={value}" for key, value in pairs]
        try:
            for override in overrides:
                parsed = OverridesParser.create().parse_override(override)
                if parsed.is_sweep_override():
                    return
                OmegaConf.update(config, parsed.key_or_group, parsed.value(), merge=False)
            settings = run_config(config)
        except (PipelineError, HydraException, OmegaConfBaseException) as error:
            self.counts[refused(Exception(one_line(error, [f"stage={stage}", *overrides])))] += 1
            return
        for item in dataclasses.fields(settings.stage):
            value = getattr(settings.stage, item.name)
            for one in value if isinstance(value, list) else [value]:
                if isinstance(one, float) and not -1e12 < one < 1e12:
                    raise WrongError(f"stage.{item.name} is {one}")
        self.counts["accepted"] += 1


class ConsoleTarget(Target):
    """Messages that a page may send."""

    name = "console"
    share = 0.5

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        fields = st.dictionaries(
            st.sampled_from(_FIELDS),
            _PLAIN,
            max_size=5,
        )
        typed = st.tuples(st.sampled_from(KINDS), fields).map(lambda pair: {"type": pair[0], **pair[1]})
        said = (typed | _PLAIN).map(lambda value: json.dumps(value))
        self.messages = said | st.text(max_size=200) | st.integers(1, 2 * LONGEST_REQUEST).map(lambda n: "[" * n)

    def run(self, seed: int) -> None:
        try_examples(self.messages, self._check, seed)

    def _check(self, text: str) -> None:
        try:
            request = read_request(text)
            if request["type"] == "controls":
                catheter = request.get("catheter", (0.0, 0.0))
                controls = Controls(request["advance"], request["rotate"], request["sequence"], *catheter)
                if not all(-1 <= axis <= 1 for axis in (*controls.wire, *controls.catheter)):
                    raise WrongError(f"controls beyond full speed: {controls}")
            if request["type"] == "answers":
                check_answers(request["answers"])
        except ValueError as error:
            self.counts[refused(error)] += 1
        else:
            self.counts["accepted"] += 1
