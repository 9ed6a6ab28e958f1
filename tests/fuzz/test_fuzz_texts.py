"""What people and pages write: settings on the command line and messages of the console."""

import dataclasses
import json
import random
from functools import cache
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from cathsim.console.controls import Controls
from cathsim.console.questionnaire import CRITERIA, check_answers
from cathsim.console.web.messages import LONGEST_REQUEST, read_request
from pipeline.config import run_config
from pipeline.launch import one_line
from pipeline.stages import available_stages, load_stage
from pipeline.store.errors import PipelineError
from tests.fuzz.mutations import NASTY, altered, rewritten, text_of
from tests.fuzz.promise import BrokenPromiseError, fuzz, refused
from tests.pipeline.composed import unchecked

KEYS = ("name", "seed", "runs_dir", "target", "modality", "phantom.name", "phantom.names", "force", "stage.none")
VALUES = ("nan", "-inf", "1e300", "-1", "0", "1e-9", "[1,2]", "{a: 1}", "null", "../x", "'a b'", "[[]]", "true",
          "9" * 400, "[nan]", "${seed}", "${nothing}", "${oc.env:HOME}", "a,b", "range(1,3)", "x" * 300)  # fmt: skip
REQUESTS: tuple[dict[str, Any], ...] = (
    {"type": "controls", "advance": 0.5, "rotate": -1, "sequence": 3, "catheter": [0.1, 0.2]},
    {"type": "answers", "answers": {criterion.key: 4 for criterion in CRITERIA}},
    {"type": "choose", "phantom": "type_1", "target": "bca", "max_steps": 200, "force_limit_n": 1.5},
    {"type": "view", "camera": "a", "primary_deg": 30, "secondary_deg": -20, "zoom": 1.5},
    {"type": "pedal", "on": True},
    {"type": "restart"},
)


@cache
def composed(stage: str) -> tuple[list[str], DictConfig]:
    """The keys of a stage's settings, and its configuration."""
    fields = dataclasses.fields(load_stage(stage).settings)  # type: ignore[arg-type]
    return [f"stage.{field.name}" for field in fields], unchecked(f"stage={stage}")


@fuzz(68831)
def test_settings(rng: random.Random) -> str:
    """Overrides of a stage give checked dataclasses with sensible numbers, or are refused."""
    stage = rng.choice(sorted(available_stages()))
    keys, whole = composed(stage)
    numbers = str(rng.choice((rng.randrange(-9, 99), rng.random(), rng.gauss(0, 1e9))))
    overrides = [
        f"{rng.choice((*keys, *KEYS))}={rng.choice((rng.choice(VALUES), numbers, rewritten(rng.choice(VALUES), rng)))}"
        for _ in range(rng.choice((1, 1, 2, 3)))
    ]
    config = whole.copy()
    try:
        for override in overrides:
            parsed = OverridesParser.create().parse_override(override)
            if parsed.is_sweep_override():
                return "refused"
            OmegaConf.update(config, parsed.key_or_group, parsed.value(), merge=False)
        settings = run_config(config)
    except (PipelineError, HydraException, OmegaConfBaseException) as error:
        return refused(Exception(one_line(error, [f"stage={stage}", *overrides])))
    for item in dataclasses.fields(settings.stage):
        value = getattr(settings.stage, item.name)
        for one in value if isinstance(value, list) else [value]:
            if isinstance(one, float) and not -1e12 < one < 1e12:
                raise BrokenPromiseError(f"stage.{item.name} is {one}")
    return "accepted"


@fuzz()
def test_console_messages(rng: random.Random) -> str:
    """A message of a page is within the limits of the controls, or refused."""
    kind = rng.randrange(4)
    if kind == 0:
        text = "[" * rng.randrange(1, 2 * LONGEST_REQUEST)
    elif kind == 1:
        text = json.dumps(rng.choice(NASTY))
    else:
        text = text_of(altered(rng.choice(REQUESTS), rng) if kind == 2 else rng.choice(REQUESTS), rng)
    try:
        request = read_request(text)
        if request["type"] == "controls":
            catheter = request.get("catheter", (0.0, 0.0))
            controls = Controls(request["advance"], request["rotate"], request["sequence"], *catheter)
            if not all(-1 <= axis <= 1 for axis in (*controls.wire, *controls.catheter)):
                raise BrokenPromiseError(f"controls beyond full speed: {controls}")
        if request["type"] == "answers":
            check_answers(request["answers"])
    except ValueError as error:
        return refused(error)
    return "accepted"
