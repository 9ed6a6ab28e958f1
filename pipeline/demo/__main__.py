"""The demo's command, ``python -m pipeline.demo``: an episode with its film and log, the page, errors in a sentence."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from pipeline.anatomies.anatomy_file import KINDS
from pipeline.printing import Parser, written
from pipeline.seeds import ARCHES
from pipeline.store.errors import PipelineError

EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 1, 2, 130
LOG, GIF, MP4 = "episode.mcap", "film.gif", "film.mp4"
GENERALIST = "generalist"  # by a roadmap
MODELS = ("navigator", GENERALIST)  # that can steer


def main(arguments: Sequence[str]) -> int:
    """Runs the command line: 0 an episode was played, 1 no file can be written, 2 wrong arguments, 130 after Ctrl-C."""
    options = _parser().parse_args(arguments)
    # Learning libraries start as many threads as there are cores, which is slower beside other work.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        run(options)
    except KeyboardInterrupt:
        return _say("interrupted: the same command begins again", EXIT_INTERRUPTED)
    except (PipelineError, ValueError) as error:
        return _say(" ".join(str(error).split()), EXIT_USAGE)
    except OSError as error:
        why = error.strerror or " ".join(str(error).split())
        return _say(f"{error.filename or options.output}: {why}: give another folder by --output", EXIT_FAILED)
    return 0


def run(options: argparse.Namespace) -> None:
    """Plays the episode and writes log, films and page."""
    from pipeline.demo.film import DemoFilm
    from pipeline.demo.page import write_page
    from pipeline.demo.steering import open_scene
    from pipeline.recording.record import record_episode

    began = time.monotonic()
    tries = options.model == GENERALIST and options.anatomy and not options.no_catheter
    trials = ", then trying devices in it" if tries else ""
    print(f"demo: loading the {options.model} and the anatomy{trials}", flush=True)
    scene = open_scene(
        options.model, anatomy=options.anatomy, unit=options.unit, seed=options.seed, target=options.target,
        attempts=options.attempts, catheter=not options.no_catheter, ct=options.ct,
    )  # fmt: skip
    print(f"demo: {scene.title}", flush=True)
    folder = Path(options.output)
    folder.mkdir(parents=True, exist_ok=True)
    film = DemoFilm(scene)
    try:
        metrics = record_episode(
            scene.environment,
            scene.steer,
            folder / LOG,
            seed=scene.start_seed,
            operator="policy",
            configuration={"stage": "demo", "row": scene.model, "mode": scene.mode},
            film=film,
        )
        film.write(folder / GIF)
        film.write_mp4(folder / MP4)
    finally:
        film.close()
        scene.environment.close()
    page = write_page(folder, scene, asdict(metrics), film.curves, {"log": LOG, "gif": GIF, "mp4": MP4})
    outcome = "reached the target" if metrics.success else "did not reach the target"
    attempt = f" at attempt {scene.steer.attempts}" if scene.steer.attempts > 1 else ""
    print(
        f"demo: {outcome}{attempt} in {metrics.steps / 10:.1f} s of simulated time, "
        f"tip {1e3 * (metrics.depth or 0.0):.0f} mm deep in {metrics.branch}, "
        f"largest force {metrics.force_max:.2f} N; {time.monotonic() - began:.0f} s in all\nopen {page}"
    )


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        written("demo"),
        description="A shipped policy steers a wire, in a catheter where the take-off is steep, through an arch that "
        "it has never seen, or through yours; "
        "film, log and page of the episode go to a folder.",
    )
    parser.add_argument("--anatomy", metavar="FILE", help=f"{KINDS}; default: a random arch")
    parser.add_argument("--unit", choices=("m", "cm", "mm", "inch"), help="of a surface; detected when left out")
    parser.add_argument("--ct", metavar="FILE", help="that the anatomy was segmented from: shown by the X-ray images")
    parser.add_argument("--target", help="branch to steer to; default: the first of bca, lcca, lsa that is there")
    parser.add_argument("--model", default=MODELS[0], choices=MODELS, help=f"that steers (default {MODELS[0]})")
    parser.add_argument(
        "--no-catheter", action="store_true",
        help="the wire alone, also where the ostium is set back so far that a catheter over it is used otherwise",
    )  # fmt: skip
    seed, attempts = _whole_number(0, ARCHES["test"].width - 1), _whole_number(1, 9)  # seeds of unseen arches
    parser.add_argument("--seed", type=seed, default=0, help="of the random arch and the start, 0 to 999 (default 0)")
    parser.add_argument("--attempts", type=attempts, default=2, help="before the episode ends, 1 to 9 (default 2)")
    parser.add_argument("--output", default="runs/demo", metavar="FOLDER", help="(default runs/demo)")
    return parser


def _whole_number(least: int, most: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        if not text.isdecimal() or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"expected a whole number from {least} to {most}, got {text!r}")
        return int(text)

    return read


def _say(sentence: str, code: int) -> int:
    print(sentence, file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
