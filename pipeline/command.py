"""The command `endonav`, which an installation brings: stages, episodes, models, a demonstration and the console."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pipeline.installation import gl_backend
from pipeline.printing import CALLED, installing, say

_FINE, _USAGE, _INTERRUPTED = 0, 2, 130
_PACKAGES = ("enn", "guide3d", "splineformer")  # that ship models
_TRAININGS = ("baselines", "enn", "imitation", "force", "unseen", "rehearsal", "shape", "segmentation", "splineformer",
              "navigation")  # fmt: skip
_HELP = """\
endonav COMMAND [ARGUMENTS]

  stages [stage=NAME ...]  run a stage; without arguments list stages, budgets and options
  chain all|STAGE ...      run stages one after the other
  episodes COMMAND FILE    look at episode logs, check, film and export them
  models [NAME]            list the trained models that are shipped, or print the card of one
  demo                     a shipped policy steers through an unseen arch or yours: film, log and page in runs/demo
  list                     environments, phantoms, targets, devices and models
  import FILE              an aorta of yours, surface or labels: its names, notes and picture
  read A [B]               the wire in an X-ray image, or in two views (--cameras FOLDER)
  train [STAGE ...]        a training stage after those that it reads (default enn)
  new KIND NAME            a stage, a policy or a phantom that runs, with its test, to be changed to your own
  data list|fetch|add      real vessels, from public addresses, in which claims are measured
  evaluate [CLAIM ...]     measure what is claimed, as the protocol says: a file of results for each claim
  hub upload|download      policies and data sets to and from the Hugging Face Hub
  console                  steer the wire yourself, in the browser
  info                     what a report of a problem needs: versions, processor, rendering, GPUs, caches
  --version

Every command has --help. Results go to runs/ in the folder in which it is called.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line; gives the exit code of what it called, 2 for wrong usage."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is None:  # this process is the command's own
        os.environ[CALLED] = "1"
        # a stream that is closed leaves its number to the next file, into which libraries would print
        sys.stdout, sys.stderr = (one or open(os.devnull, "w") for one in (sys.stdout, sys.stderr))  # noqa: SIM115
    if not words or words[0] in ("-h", "--help"):
        say(_HELP)
        return _FINE if words else _USAGE
    if words == ["--version"]:
        say(f"endonav {importlib.metadata.version('endonav')}")
        return _FINE
    if words[0] not in _COMMANDS:
        say(f"endonav has no command {words[0]!r}: choose from {', '.join(_COMMANDS)}", error=True)
        return _USAGE
    if "MUJOCO_GL" not in os.environ and (backend := gl_backend()):
        os.environ["MUJOCO_GL"] = backend
    command, further = _COMMANDS[words[0]], words[1:]
    if words[0] in ("stages", "chain"):
        further = further or ["--help"]
    try:
        return int((importlib.import_module(command).main if isinstance(command, str) else command)(further))
    except KeyboardInterrupt:
        return _INTERRUPTED
    except ModuleNotFoundError as error:
        known = "pip install" in str(error)  # else Python's own words, which say no more than the name
        say(f"endonav {words[0]}: {error}" if known else f"endonav {words[0]} needs the module {error.name}: "
            f"{installing('make setup')}", error=True)  # fmt: skip
        return _USAGE


def _models(arguments: list[str]) -> int:
    """Lists the shipped models, or prints cards."""
    shipped: dict[str, tuple[str, Any]] = {}
    for name in _PACKAGES:
        package = importlib.import_module(f"{name}.shipped")
        shipped |= {f"{name} {model}": (sentence, package) for model, sentence in package.models().items()}
    if arguments[:1] in (["-h"], ["--help"]):
        say("endonav models [NAME]: lists the trained models that are shipped, or prints the card of one")
        return _FINE
    if not arguments or arguments[-1] in _PACKAGES:
        listed = [
            f"{name}: {one[0]}" for name, one in shipped.items() if not arguments or name.split()[0] == arguments[-1]
        ]
        say("\n".join(listed) or "no model is shipped")
        return _FINE
    matches = [(full.split()[1], package) for full, (_, package) in shipped.items() if full.split()[1] == arguments[-1]]
    if not matches:
        known = ", ".join(full.split()[1] for full in shipped) or "none, as none is shipped"
        say(f"there is no model {arguments[-1]!r}: choose from {known}", error=True)
        return _USAGE
    say("\n".join(package.card(name) for name, package in matches))
    return _FINE


def _list(arguments: list[str]) -> int:
    """Lists what can be chosen by name, a line a kind."""
    import gymnasium

    import cathsim

    if arguments:
        say("endonav list: prints environments, phantoms, targets, devices and models; it takes no arguments")
        return _FINE if arguments[0] in ("-h", "--help") else _USAGE
    names = {
        "environments": sorted(name for name in gymnasium.registry if name.startswith("cathsim/")),
        "phantoms": [*cathsim.PHANTOMS, "random_0, random_1, … (also random_steep_7, random_wide_7, arch_variety_7)"],
        "wires": list(cathsim.GUIDEWIRES), "catheters": list(cathsim.CATHETERS),
        "targets of type_1": list(cathsim.load_phantom("type_1").targets),
    }  # fmt: skip
    say("\n".join(f"{kind}: {', '.join(entries)}" for kind, entries in names.items()))
    say("models:")
    return _models([])


def _import(arguments: list[str]) -> int:
    """Builds the phantom of a file by the stage phantoms, whose picture and notes say what was understood."""
    from pipeline.launch import main as launch
    from pipeline.settings.quoting import quoted

    if not arguments or arguments[0].startswith("-"):
        say("endonav import FILE [phantom.unit=mm phantom.labels=... name=RUN]: imports a surface, a label volume or a "
            "folder of them, and draws it in runs/NAME/phantoms (NAME: import-FILE)", error=not arguments)  # fmt: skip
        return _FINE if arguments else _USAGE
    file, further = f"phantom.file={quoted(arguments[0])}", arguments[1:]
    if not any(word.startswith("name=") for word in further):
        stem = re.sub(r"[^A-Za-z0-9_-]+", "_", Path(arguments[0]).name.partition(".")[0])
        further = [f"name=import-{stem}", *further]
    return launch(["stage=phantoms", file, *further])


def _read(arguments: list[str]) -> int:
    from guide3d.commands import run
    from guide3d.reading.command import main as read

    run(lambda: read(arguments, program="endonav read"))


def _train(arguments: list[str]) -> int:
    """Runs a stage after those that it reads."""
    from pipeline.chain import main as chain

    stages = [word for word in arguments if "=" not in word and not word.startswith("-")] or ["enn"]
    if arguments[:1] in (["-h"], ["--help"]):
        say("endonav train [STAGE ...] [KEY=VALUE ...]: runs stages after those that they read, such as\n"
            "endonav train enn budget=smoke; TensorBoard's curves are in runs/NAME/STAGE")  # fmt: skip
        return _FINE
    if wrong := [stage for stage in stages if stage not in _TRAININGS]:
        say(f"{wrong[0]} trains nothing: choose from {', '.join(_TRAININGS)}", error=True)
        return _USAGE
    return chain(["--inputs", *stages, "--", *(word for word in arguments if word not in stages)])


def _info(arguments: list[str]) -> int:
    from pipeline.system_info import report

    if arguments:
        say("endonav info: prints what a report of a problem needs; it takes no arguments")
        return _FINE if arguments[0] in ("-h", "--help") else _USAGE
    say(report())
    return _FINE


# A function, or the module whose `main` takes the arguments.
_COMMANDS: dict[str, Callable[[list[str]], int] | str] = {
    "stages": "pipeline.launch", "chain": "pipeline.chain", "episodes": "pipeline.episodes.__main__",
    "models": _models, "demo": "pipeline.demo.__main__", "list": _list, "import": _import,
    "read": _read, "train": _train, "new": "pipeline.templates",
    "evaluate": "pipeline.protocol.command", "data": "pipeline.data.command", "hub": "pipeline.hub",
    "console": "pipeline.console", "info": _info,
}  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
