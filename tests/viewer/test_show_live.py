"""A stream in Rerun: the states as they were known when their pairs had come."""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.frontend.rectification import Rectifier
from polhode.pipeline.live.run_live import WatchedPair
from polhode.pipeline.stream.stream import LiveState, Observed
from polhode.records.dataset import StereoImages
from polhode.viewer import show_live as module
from polhode.viewer.recorder import Recorder
from polhode.viewer.show_live import watching
from polhode.viewer.target import ViewTarget
from tests.pipeline.conftest import N_FRAMES, RIG, Example
from tests.viewer.read_recording import rows_of, values_of

SEARCHING = 3
"""Pairs before a motion is known."""
SIZE_PX = RIG.width_px, RIG.height_px
RECTIFIER = Rectifier(RIG, np.eye(4), None, (SIZE_PX, SIZE_PX))
Surface = Callable[[], "Future[Any] | None"]


def no_surface() -> None:
    """As with one process."""


def watched(example: Example, k: int, request_surface: Surface = no_surface) -> WatchedPair:
    """Pair k of the run as a stream passes it on."""
    estimate, mass, tracks = example.estimate, example.estimate.mass, example.tracks
    rows = tracks.frame == k
    state = LiveState(
        timestamp_ns=int(estimate.timestamps_ns[k]), r_N=estimate.r_N[k], v_N=estimate.v_N[k],
        R_NP=estimate.R_NP[k], w_P=estimate.w_P[k], covariance=estimate.covariance[k], X_NG=estimate.X_NG[k],
        k=np.array([mass.k1, mass.k2]), cov_k=mass.cov_k, com_G=mass.com_G, cov_com_G=mass.cov_com_G,
        R_GP=mass.R_GP, cov_R_GP=mass.cov_R_GP, xi=np.zeros(5), cov_J=np.eye(5),
        determined=np.full(4, k >= 10), number=k, status="searching" if k < SEARCHING else "measured",
        observations=int(rows.sum()), restarts=0, sigma_rate=0.01, seconds={},
        consistent=True, reason="", frame_of_reference=None,
    )  # fmt: skip
    image = np.full((RIG.height_px, RIG.width_px), 40, dtype=np.uint8)
    observed = Observed(tracks.uvd_px[rows, :2], tracks.landmark[rows], tracks.landmark[rows] % 2 == 0)
    images, landmarks_G = StereoImages(image, image, None, None), estimate.landmarks.p_G
    return WatchedPair(state, images, RECTIFIER, np.eye(4), observed, landmarks_G, request_surface)


def test_states_features_and_landmarks_as_they_come(
    example: Example, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "live.rrd"
    with watching(ViewTarget(file, window=False), "live") as watch:
        for k in range(N_FRAMES):
            watch(watched(example, k))
    position = values_of(file, "/plots/r_N_m", "Scalars:scalars")
    assert list(position) == list(range(SEARCHING, N_FRAMES)), "nothing is shown while no motion is known"
    np.testing.assert_allclose(list(position.values()), example.estimate.r_N[SEARCHING:], rtol=1e-15)
    ratios = np.array(list(values_of(file, "/plots/k", "Scalars:scalars").values()))
    assert np.isnan(ratios[:10]).all() and np.isfinite(ratios[10:]).all()
    counts = np.array(list(values_of(file, "/plots/observations", "Scalars:scalars").values()))
    landmark, frame = example.tracks.landmark, example.tracks.frame
    assert counts[:, 0].tolist() == np.bincount(frame[landmark % 2 == 0], minlength=N_FRAMES).tolist()
    landmarks = values_of(file, "/N/target/landmarks", "Points3D:positions")
    assert {len(points) for points in landmarks.values()} == {len(example.estimate.landmarks.p_G)}
    assert len(values_of(file, "/N/camera/left", "EncodedImage:blob")) > 0
    # a viewer that falls behind shows pairs without their images
    monkeypatch.setattr(module, "MAX_WAITING", 0)
    file = tmp_path / "behind.rrd"
    with watching(ViewTarget(file, window=False), "live") as watch:
        for k in range(5):
            watch(watched(example, k))
    assert all("EncodedImage:blob" not in row for _, row in rows_of(file)["/N/camera/left"])
    assert list(values_of(file, "/plots/observations", "Scalars:scalars")) == list(range(5))


def test_a_surface_is_shown_once_it_is_made_and_removed_with_its_frame_g(
    example: Example, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SURFACE_EVERY", 4)
    file, made = tmp_path / "live.rrd", list[Future[Any]]()

    def request() -> Future[Any]:
        made.append(Future())
        return made[-1]

    with watching(ViewTarget(file, window=False), "live") as watch:
        for k in range(16):
            if k == 6:
                made[0].set_result(example.surface)
            if k == 9:
                made[1].set_exception(RuntimeError("the process has ended"))
            pair = watched(example, k, request)
            # from pair 13 on in another frame G, in which the third surface is not
            watch(replace(pair, state=replace(pair.state, restarts=int(k >= 13))))
            if k == 13:
                made[2].set_result(example.surface)
    faces = values_of(file, "/N/target/mesh", "Mesh3D:triangle_indices")
    assert {k: len(each) for k, each in faces.items()} == {6: len(example.surface.mesh.faces)}
    assert list(values_of(file, "/N/target/mesh", "Clear:is_recursive")) == [13]
    assert len(made) == 4, "asked for at pairs 3, 7, 11 and 15"


def test_an_interrupted_stream_leaves_no_recording(example: Example, tmp_path: Path) -> None:
    file = tmp_path / "live.rrd"

    def interrupted() -> None:
        with watching(ViewTarget(file, window=False), "live") as watch:
            watch(watched(example, 0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_a_viewer_that_fails_is_one_warning_and_the_stream_goes_on(
    example: Example, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(self: Recorder, frame: object) -> None:
        raise RuntimeError("the window\nwas closed")

    monkeypatch.setattr(Recorder, "log_frame", broken)
    with watching(ViewTarget(tmp_path / "live.rrd", window=False), "live") as watch:
        for k in range(4):
            watch(watched(example, k))
    assert caplog.messages == ["the stream is not shown any more: the window was closed"]
