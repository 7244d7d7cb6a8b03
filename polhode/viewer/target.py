"""Where a recording goes: a file, Rerun's window, or both; checked before any work."""

import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from time import monotonic, sleep

import rerun as rr
import rerun.blueprint as rrb

from polhode.files.atomic import write_bytes
from polhode.files.output.single_file import make_parent, output_file
from polhode.runtime.errors import InputError, printable
from polhode.viewer.recorder import Recorder, ShownRig

APPLICATION = "polhode"
START_S = 30.0
"""The window must take data within this time."""
ELSEWHERE = "--save FILE writes the recording instead, which 'rerun FILE' shows on another machine"

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ViewTarget:
    """What the user asked for."""

    file: Path | None
    """Links followed; None: no file is written"""
    window: bool

    @contextmanager
    def opened(self, name: str, rig: ShownRig, blueprint: rrb.Blueprint) -> Iterator[Recorder]:
        """A recorder; when the block succeeds, the file is complete and the window has everything.

        name: of what is shown. Raises InputError where the window does not open, RunFailure where the file
        cannot be written.
        """
        with ExitStack() as stack:
            streams = []
            if self.file is not None:
                streams.append(stack.enter_context(_to_file(self.file, name, blueprint)))
            if self.window:
                streams.append(stack.enter_context(_to_window(name, blueprint)))
            yield Recorder(streams, rig)


def require_target(file: Path | None, window: bool, option: str = "--save") -> ViewTarget:
    """Raise InputError: the file, which ``option`` names, would replace another one or cannot be written;
    there is no display."""
    if window and sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
        raise InputError(f"no display for Rerun's window (DISPLAY is not set): {ELSEWHERE}")
    if file is None:
        return ViewTarget(None, window)
    place = output_file(file, "view", "recording.rrd", is_recording, option=option)
    if file.suffix != ".rrd":
        raise InputError(f"{file}: give a name that ends in .rrd, by which Rerun knows its recordings")
    make_parent(place, file)
    return ViewTarget(place, window)


def is_recording(path: Path) -> bool:
    """Whether a file begins as a recording of this program."""
    with path.open("rb") as stream:
        # the name of the program that made it stands at its beginning
        head = stream.read(4096)
    return head.startswith(b"RRF2") and APPLICATION.encode() in head


@contextmanager
def _to_file(place: Path, name: str, blueprint: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """A stream whose content becomes the file when the block succeeds."""
    stream = _stream(name)
    content = stream.binary_stream()
    stream.send_blueprint(blueprint)
    yield stream
    data = content.read(flush=True) or b""
    stream.disconnect()
    write_bytes(place, data)


@contextmanager
def _to_window(name: str, blueprint: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """A stream to a window of its own, which stays when this program ends."""
    address = _open_window()
    stream = _stream(name)
    stream.connect_grpc(f"rerun+http://{address}/proxy", default_blueprint=blueprint)
    try:
        yield stream
    finally:
        try:
            stream.flush(timeout_sec=60.0)
        except Exception as error:  # noqa: BLE001  the window was closed, which is no failure
            _log.warning("Rerun's window did not take everything: %s", printable(str(error)))
        stream.disconnect()


def _stream(name: str) -> rr.RecordingStream:
    """A stream that logs nothing of the clock, so that the same run gives the same data."""
    stream = rr.RecordingStream(APPLICATION, recording_id=printable(name), send_properties=False)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    return stream


def _open_window() -> str:
    """Start Rerun's viewer, on this machine alone; returns its address. Raises InputError: it has ended."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-P", "-m", "rerun_cli", "--bind", "127.0.0.1", "--port", str(port)]
    # The viewer sends statistics of its use over the network, but never where CI is set; its settings, which
    # are the user's, stay as they are.
    environment = {**os.environ, "CI": "true", "RUST_LOG": "error"}
    with TemporaryFile() as output:
        viewer = subprocess.Popen(  # noqa: S603  the interpreter that runs this, and words of this function
            [*command, "--expect-data-soon"],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,
        )
        end, is_open = monotonic() + START_S, False
        while not is_open:
            if viewer.poll() is not None or monotonic() > end:
                output.seek(0)
                lines = [each.strip() for each in output.read().decode(errors="replace").splitlines()]
                said = [f" ({printable(each)})" for each in lines if each]
                with suppress(ProcessLookupError):
                    # the viewer is a child of what was started
                    os.killpg(viewer.pid, signal.SIGKILL)
                raise InputError(f"Rerun's window did not open{''.join(said[-1:])}: {ELSEWHERE}")
            sleep(0.05)
            with socket.socket() as probe:
                is_open = probe.connect_ex(("127.0.0.1", port)) == 0
    return f"127.0.0.1:{port}"
