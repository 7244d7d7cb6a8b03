"""The code of docs/api.md, from top to bottom; and that stage by stage the result is that of a run."""

import re
import runpy
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import polhode
from polhode import stages
from polhode.config import Config
from polhode.geometry.lie import log_so3, transform_points
from polhode.mapping.mesh_files import write_ply
from polhode.pipeline.context import RunContext, open_context
from polhode.planning.keep_out.volumes import KeepOutOptions
from polhode.run_directory.finished_stages import StageStore
from polhode.run_directory.trajectory_file import trajectory_of, write_trajectory
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress

NO_PICTURES = {"outputs": ["motion", "surface"]}
PAGE = Path(__file__).parents[2] / "docs" / "api.md"


@pytest.fixture(scope="module")
def page(
    rendered_sequence: Path, finished: Path, tmp_path_factory: pytest.TempPathFactory
) -> SimpleNamespace:
    """The names that the page leaves, its ``folder``, and the ``results`` that its stages have taken.

    The run of the page is resumed from another one, and its stages find their results by a digest of all
    their inputs.
    """
    folder = tmp_path_factory.mktemp("page")
    (folder / "SEQ").symlink_to(rendered_sequence)
    shutil.copytree(finished, folder / "RUN")
    results = StageStore(folder / "RUN" / "stages", f"{Config().runtime.blas_threads} threads")

    def opened(data: Path, config: Config, progress: Progress) -> RunContext:
        return replace(open_context(data, config, progress), stages=results)

    of_frames = RunContext.of_frames

    def apart(context: RunContext, frames: list[int]) -> RunContext:
        """Of some frames, which no run has taken: their results are no results of the page's stages."""
        return replace(of_frames(context, frames), stages=StageStore())

    code = "\n".join(re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL))
    (folder / "page.py").write_text(code)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(polhode, "run", partial(polhode.run, config=NO_PICTURES, resume=True))
        patch.setattr(stages, "open_context", opened)
        patch.setattr(RunContext, "of_frames", apart)
        # The mesh of so few frames is open; the distances from its hull would take most of the time.
        patch.setattr("polhode.planning.keep_out.measured_body.OPEN_SHARE", 1.0)
        patch.setattr("polhode.api.KeepOutOptions", partial(KeepOutOptions, cells=36))
        names = runpy.run_path("page.py")
    # What is read later is read from another working directory.
    names["run"] = polhode.load(folder / "RUN")
    return SimpleNamespace(**{**names, "folder": folder, "results": results})


def test_the_page_runs_and_stage_by_stage_the_files_are_those_of_the_run(
    page: SimpleNamespace, tmp_path: Path
) -> None:
    assert page.run.status == "ok" and page.errors["rmse_position_m"] < 2e-3
    made = {path.name for path in page.folder.iterdir()}
    assert made == {"SEQ", "RUN", "SIMULATED", "motion.tum", "run.tum", "page.py"}
    assert page.results.stored == 0 and page.results.found > 2 * len(page.features)
    assert 0 < len(page.observations) <= len(page.run.measurements.frame)
    assert set(page.observations["landmark"]) == set(page.run.landmark_numbers)
    assert page.initial.connected.all()
    shift_m = page.other.r_N - page.run.trajectory.r_N
    # Along what so few frames do not determine, the two forms differ; by much less than the sigmas there.
    assert np.abs(shift_m).max() > 0.0
    assert (np.abs(shift_m) < 0.5 * page.run.trajectory.sigma_r).all()
    write_trajectory(trajectory_of(page.estimate), tmp_path / "trajectory.csv")
    write_ply(page.finished.surface, tmp_path / "mesh.ply")
    for name in ("trajectory.csv", "mesh.ply"):
        assert (tmp_path / name).read_bytes() == (page.folder / "RUN" / name).read_bytes(), name


def test_a_pair_by_itself_gives_what_it_gives_in_the_run_and_two_frames_the_relative_pose(
    page: SimpleNamespace,
) -> None:
    np.testing.assert_array_equal(page.points.uvd_px, page.features[0].uvd_px)
    in_run = next(stages.depth_maps(page.context, page.features))
    np.testing.assert_array_equal(page.depth.depth_m, in_run.depth_m)
    assert page.pair.mask_left.any() and page.pair.left.dtype == np.uint8
    with pytest.raises(InputError, match="pair 14: the sequence has pairs 0 to 13"):
        stages.rectified_pair(page.context, 14)
    assert (page.match.i, page.match.j) == (0, 1) and len(page.match) > 20
    assert np.rad2deg(np.linalg.norm(log_so3(page.difference[:3, :3]))) < 0.5
    assert np.linalg.norm(page.difference[:3, 3]) < 5e-3
    for stage in (stages.match_features, stages.depth_maps):
        with pytest.raises(InputError, match="features of 14 frames for a context of 2"):
            stage(page.two, page.features)


def test_frames_that_are_none_of_the_context_are_refused(page: SimpleNamespace) -> None:
    wrong: list[tuple[list[Any], str]] = [
        ([1, 0], "0 follows 1; give each frame once, in ascending order"),
        ([2, 2], "2 follows 2; give each frame once"),
        ([0, 14], "there is no frame 14; the sequence has frames 0 to 13"),
        ([-1, 3], "there is no frame -1;"),
        ([], "give one or more whole numbers"),
        ([0.5], "give one or more whole numbers"),
    ]
    for frames, words in wrong:
        with pytest.raises(InputError, match=words):
            page.context.of_frames(frames)
    some = page.context.of_frames(np.array([1, 4]))
    np.testing.assert_array_equal(some.X_NR, page.context.X_NR[[1, 4]])


def test_records_have_the_fields_of_the_table_and_the_shapes_of_the_page(page: SimpleNamespace) -> None:
    examples = {
        type(each).__name__: each
        for each in (
            *(page.pair, page.features[0], page.correspondences, page.correspondences.matches[0]),
            *(page.correspondences.links, page.tracks, page.initial, page.depth),
        )
    }
    record, seen = "", set()
    for row in PAGE.read_text().split("| record | field |")[1].split("\n\n")[0].splitlines()[2:]:
        name, names = row.split("|")[1:3]
        record = name.strip(" `") or record
        seen.add(record)
        for field in re.findall(r"`(\w+)`", names):
            assert hasattr(examples[record], field), f"{record}.{field}"
    assert seen == set(examples)
    features, links, match = page.features[0], page.correspondences.links, page.correspondences.matches[0]
    assert len(features) == len(features.uvd_px) == len(features.sigma_px) == len(features.scale_px) > 0
    np.testing.assert_allclose(features.p_R, page.context.rig.triangulate(features.uvd_px))
    np.testing.assert_allclose(np.linalg.norm(features.descriptors, axis=1), 1.0, atol=1e-5)
    assert len(links) == len(links.i) == len(links.X_RiRj) and (links.i < links.j).all()
    # what the pose of a pair says of its matches: from the camera at j to the one at i
    assert len(match) == len(match.features) and match.i < match.j
    p_Ri, p_Rj = (page.features[k].p_R[match.features[:, n]] for n, k in enumerate((match.i, match.j)))
    moved = transform_points(match.X_RiRj, p_Rj)
    assert np.median(np.linalg.norm(moved - p_Ri, axis=1)) < 5e-3
    assert np.median(np.linalg.norm(p_Rj - p_Ri, axis=1)) > 5e-3
