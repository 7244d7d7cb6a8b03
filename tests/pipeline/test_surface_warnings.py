"""What the fusion has to tell of depth and poses, by what a run says: terminal, summary, report, log."""

import html
import json
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.cli.main import main
from polhode.frontend.extract import extract_depth
from polhode.geometry.lie import make_pose
from polhode.mapping.fusion.field import Frame, fuse
from polhode.records.surface import DepthMap, SurfaceModel
from tests.pipeline.conftest import FAST, REST_FRAMES
from tests.pipeline.synthetic_front_end import NO_WINDOW

OF_MOTION = ("features", "matches", "initial_motion", "first_motion", "best_motion")
"""Stages before depth and surface"""


@dataclass(frozen=True)
class Defect:
    """What is wrong, and the words for it."""

    message: str
    without_depth: tuple[int, ...] = ()
    """Frames whose depth is NaN all over"""
    poses: Callable[[int, Any], Any] = lambda k, X_RG: X_RG
    """What becomes of the pose of frame k on the way to the fusion"""
    options: tuple[str, ...] = ()


DEFECTS = {
    "no depth": Defect("no frame has valid depth: there is no surface", tuple(range(REST_FRAMES))),
    "little depth": Defect("4 of 6 frames have no valid depth", (0, 1, 3, 4)),
    "one frame": Defect("the surface is made of 1 frame: nothing confirms its parts", (0, 1, 2, 3, 5)),
    "no overlap": Defect(
        "no part of the surface was seen in 3 frames",
        poses=lambda k, X_RG: X_RG @ make_pose(np.eye(3), [0.4 * k, 0.0, 0.0]),
    ),
    "full": Defect(
        "the field of 3 MiB is full and parts of the surface are missing",
        options=("--mapping.memory-mib", "3", "--mapping.voxel-mm", "1.5"),
    ),
}


def command(sequence: Path, folder: Path) -> list[str]:
    words = ["run", "configs/default.yaml", "--data", str(sequence), "-o", str(folder)]
    return [*words, *FAST, *NO_WINDOW]


@pytest.fixture(scope="module")
def undisturbed(run_at_rest: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run without defects, from whose motion the others go on: the defects come later."""
    folder = tmp_path_factory.mktemp("undisturbed") / "run"
    shutil.copytree(run_at_rest / "R", folder)
    for stage in (folder / "stages").iterdir():
        if stage.is_dir() and stage.name not in OF_MOTION:
            shutil.rmtree(stage)
    return folder


@pytest.mark.parametrize("defect", DEFECTS.values(), ids=DEFECTS.keys())
def test_what_is_wrong_with_depth_and_poses_reaches_the_user(
    defect: Defect,
    at_rest: Path,
    undisturbed: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def maps(*arguments: Any) -> Iterator[DepthMap]:
        for k, depth in enumerate(extract_depth(*arguments)):
            nan = np.full_like(depth.depth_m, np.nan)
            yield replace(depth, depth_m=nan) if k in defect.without_depth else depth

    def fused(frames: Iterable[Frame], *more: Any, **others: Any) -> SurfaceModel:
        given = ((depth, defect.poses(k, X_RG)) for k, (depth, X_RG) in enumerate(frames))
        return fuse(given, *more, **others)

    monkeypatch.setattr("polhode.pipeline.depth_maps.extract_depth", maps)
    monkeypatch.setattr("polhode.pipeline.build_surface.fuse", fused)
    folder = Path(shutil.copytree(undisturbed, tmp_path / "run"))
    assert main([*command(at_rest, folder), *defect.options, "--resume"]) == 0

    summary = json.loads((folder / "summary.json").read_text())
    (line,) = [text for text in summary["warnings"] if text.startswith(defect.message)]
    assert f"warning: {line}" in capsys.readouterr().out.splitlines()
    assert line in (folder / "log.txt").read_text()
    assert line in html.unescape((folder / "report.html").read_text())
    # never a wrong closed surface
    if len(defect.without_depth) < REST_FRAMES:
        assert (folder / "mesh.ply").is_file() and summary["mesh"]["closed"] is False
    else:
        assert not (folder / "mesh.ply").exists() and summary["status"] == "degraded"
