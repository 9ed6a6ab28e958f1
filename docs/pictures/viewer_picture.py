"""Takes the picture of docs/pipeline/logs.md: an episode in Rerun's web viewer, in a browser without a screen.

    python docs/pictures/viewer_picture.py [LOG.mcap]

Needs the extra rerun, the package websockets, and Chromium.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
import websockets
from PIL import Image

from cathsim import NavigateEnv
from cathsim.planning.sampling import SamplingExpert
from pipeline.episodes.rerun import save_recording
from pipeline.recording.record import record_episode

PICTURE = Path(__file__).parent / "rerun.png"
SIZE = (1400, 860)
DRAWING_S = 25.0  # the scene is drawn by the processor


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def expert_episode(path: Path) -> None:
    """Logs an expert's episode into the BCA."""
    environment = NavigateEnv("type_1", "bca", observation="tip", image_size=256)
    expert = SamplingExpert(environment, seed=0)
    record_episode(environment, lambda *_: expert.action(), path, seed=0, operator="sampling_expert")
    expert.close()


@contextlib.contextmanager
def running(*command: str) -> Iterator[None]:
    """Keeps a program running, and ends it with all that it started."""
    silent = subprocess.DEVNULL
    process = subprocess.Popen(command, stdout=silent, stderr=silent, start_new_session=True)
    try:
        yield
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait()


def page_of(port: int) -> str:
    """Address of the browser's page for its debugging protocol, once there is one."""
    for _ in range(100):
        with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            for target in json.load(answer):
                if target["type"] == "page":
                    return str(target["webSocketDebuggerUrl"])
        time.sleep(0.2)
    raise TimeoutError("the browser shows no page")


async def photograph(address: str) -> bytes:
    """The page as a PNG, after time to draw."""
    async with websockets.connect(address, max_size=None) as browser:
        await asyncio.sleep(DRAWING_S)
        await browser.send(json.dumps({"id": 1, "method": "Page.captureScreenshot"}))
        while True:
            answer = json.loads(await browser.recv())
            if answer.get("id") == 1:
                return base64.b64decode(answer["result"]["data"])


def main() -> None:
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        sys.exit("there is no Chromium to take the picture with")
    with tempfile.TemporaryDirectory() as folder:
        log = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder) / "episode.mcap"
        if len(sys.argv) == 1:
            expert_episode(log)
        recording = save_recording(log, Path(folder) / "episode.rrd")
        data, web, debugging = (free_port() for _ in range(3))
        source = urllib.parse.quote(f"rerun+http://127.0.0.1:{data}/proxy", safe="")
        serve = [
            "--serve-web",
            "--bind",
            "127.0.0.1",
            "--port",
            str(data),
            "--web-viewer-port",
            str(web),
            str(recording),
        ]
        options = [
            "--headless=new",
            "--no-sandbox",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            f"--user-data-dir={folder}/browser",
            f"--remote-debugging-port={debugging}",
            f"--window-size={SIZE[0]},{SIZE[1]}",
        ]
        with running(sys.executable, "-m", "rerun", *serve):
            time.sleep(3.0)
            with running(browser, *options, f"http://127.0.0.1:{web}/?url={source}&renderer=webgl"):
                png = asyncio.run(photograph(page_of(debugging)))
    picture = Image.fromarray(np.asarray(Image.open(BytesIO(png)).convert("RGB")))
    picture.quantize(128, dither=Image.Dither.NONE).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
