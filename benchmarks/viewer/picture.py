"""A picture of what the viewer shows of a run, at one time of it.

    python -m benchmarks.viewer.picture RUN SEQ --at-s 20 -o docs/images/viewer.png

The recording of ``polhode view RUN --data SEQ`` is opened by Rerun without a window, which needs a driver of
Vulkan: on a machine without a graphics card, Mesa's (on Debian: apt-get install mesa-vulkan-drivers).
"""

import os
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from time import monotonic, sleep
from typing import Annotated

from PIL import Image
from rerun.experimental import ViewerClient
from tyro.conf import Positional, arg

from benchmarks.command import command, polhode

START_S, DRAW_S = 60.0, 6.0
SIZE = "1400x900"
TITLE_SHARE = 0.038
"""Of the height: the bar above the views, which is cut off"""
COLOURS = 256


def main(
    run: Annotated[Positional[Path], arg(metavar="RUN", help="Folder of the run.")],
    sequence: Annotated[Positional[Path], arg(metavar="SEQ", help="Folder of its sequence.")],
    output: Annotated[Path, arg(aliases=["-o"], metavar="PNG", help="The picture.")],
    at_s: Annotated[float, arg(help="Time since the first frame [s].")] = 20.0,
    width_px: Annotated[int, arg(help="Width of the picture.")] = 1000,
) -> None:
    """Record, draw and write the picture."""
    with tempfile.TemporaryDirectory() as temporary:
        recording, whole = Path(temporary) / "run.rrd", Path(temporary) / "whole.png"
        polhode("view", run, "--data", sequence, "--save", recording)
        _draw(recording, whole, at_s)
        picture = Image.open(whole).convert("RGB")
        picture = picture.crop((0, round(TITLE_SHARE * picture.height), picture.width, picture.height))
        small = picture.resize(
            (width_px, round(width_px * picture.height / picture.width)), Image.Resampling.LANCZOS
        )
        small.quantize(COLOURS, Image.Quantize.FASTOCTREE).save(output, optimize=True)


def _draw(recording: Path, png: Path, at_s: float) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    words = [str(recording), "--headless", "--bind", "127.0.0.1", "--port", str(port), "--window-size", SIZE]
    viewer = subprocess.Popen(
        [sys.executable, "-m", "rerun_cli", *words],
        env={**os.environ, "CI": "true", "RUST_LOG": "error"},
        start_new_session=True,
    )
    try:
        end = monotonic() + START_S
        while not _listens(port):
            if monotonic() > end or viewer.poll() is not None:
                raise SystemExit("Rerun did not start")
            sleep(0.1)
        client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
        sleep(DRAW_S)
        client.set_time("time", duration=at_s, play_state="paused")
        sleep(DRAW_S)
        client.save_screenshot(str(png))
        sleep(DRAW_S)
    finally:
        os.killpg(viewer.pid, signal.SIGTERM)


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


if __name__ == "__main__":
    command(main)
