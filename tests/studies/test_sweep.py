"""The flow of a study: what is computed, what is stored, what is computed again."""

import shutil
from array import array
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from distributed import Client
from distributed.scheduler import KilledWorker, WorkerState

import polhode
import polhode.pipeline.run
from polhode.cli.main import main
from polhode.config import Config
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Progress
from polhode.studies import steps as work
from polhode.studies import sweep as flow
from polhode.studies.cluster import Cluster
from polhode.studies.store import Store
from polhode.studies.study import open_study
from tests.conftest import RENDERED_FRAMES
from tests.studies.conftest import BASELINES, SCENE, Sweep, WriteStudy, timeless

SIMULATED: dict[str, Any] = {
    "base": {"scene": SCENE},
    "axes": {BASELINES: [0.1, 0.2], "backend.accel_psd": [1e-6, 1e-5, 1e-4]},
    "steps": ["simulate"],
}


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was computed: addresses of points, digests of sequences."""
    made: list[str] = []
    for name, key in (("compute_point", "address"), ("simulate_sequence", "digest")):
        real: Callable[..., Any] = getattr(work, name)

        # by its name, as pickles refer to it, it is still a function of that module
        @wraps(real)
        def noted(job: Any, *more: Any, real: Callable[..., Any] = real, key: str = key) -> Any:
            made.append(getattr(job, key))
            return real(job, *more)

        for module in (work, flow):
            monkeypatch.setattr(module, name, noted)
    return made


def test_a_point_is_a_row_and_a_sequence_is_simulated_once(
    write_study: WriteStudy, sweep_here: Sweep, calls: list[str], tmp_path: Path
) -> None:
    swept = sweep_here(write_study(**SIMULATED), tmp_path / "out")
    assert (swept.points, swept.stored, swept.failed) == (6, 0, 0)
    assert len(calls) == len(set(calls)) == 6 + 2
    frame = polhode.load_study(tmp_path / "out")
    assert frame["point"].tolist() == list(range(6))
    assert frame[BASELINES].tolist() == [0.1, 0.1, 0.1, 0.2, 0.2, 0.2]
    assert set(frame["status"]) == {"done"} and frame["digest.sequence"].nunique() == 2
    assert sorted(calls) == sorted({*frame["digest.point"], *frame["digest.sequence"]})
    sequences = sorted((tmp_path / "out" / "sequences").iterdir())
    assert [(each / "mav0" / "target0").is_dir() for each in sequences] == [True, True]
    # sequences that no point needs any more are removed when asked
    sweep_here(write_study(**SIMULATED, keep_sequences=False), tmp_path / "other")
    assert list((tmp_path / "other" / "sequences").iterdir()) == []
    assert set(polhode.load_study(tmp_path / "other")["status"]) == {"done"}


def test_the_same_command_computes_only_what_is_missing(
    write_study: WriteStudy,
    sweep_here: Sweep,
    calls: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path, out = write_study(**SIMULATED), tmp_path / "out"
    assert main(["sweep", str(path), "-o", str(out)]) == 0
    assert "stored" not in (said := capsys.readouterr().out) and "looked up" not in said
    assert {"points: 6", "table: 1"} <= {line.partition(" in ")[0] for line in said.splitlines()}
    # of a sequence that was rendered once, all of its points have the time
    rendered = polhode.load_study(out)["time.simulate_s"]
    assert (rendered > 0.0).all() and rendered.nunique() == 2
    before = timeless(out)
    calls.clear()
    assert sweep_here(path, out).stored == 6 and calls == []
    store, lost = Store(out), before["digest.point"].to_pylist()[1:3]
    # an unfinished study has the rows that are stored
    (out / "table.parquet").unlink()
    assert timeless(out) == before
    store.pack(without=set(lost))
    assert polhode.load_study(out)["point"].tolist() == [0, 3, 4, 5]
    assert main(["sweep", str(path), "-o", str(out)]) == 0 and calls == lost
    assert "note: 4 of 6 points are stored already\n" in capsys.readouterr().out
    assert timeless(out) == before
    more = {**SIMULATED, "axes": {**SIMULATED["axes"], BASELINES: [0.2, 0.3]}}
    calls.clear()
    assert sweep_here(write_study(**more), out).stored == 3
    assert len(calls) == 3 + 1
    assert polhode.load_study(out)[BASELINES].tolist() == [0.2, 0.2, 0.2, 0.3, 0.3, 0.3]


def test_a_point_that_fails_is_a_row_with_its_reason_and_tried_again_when_asked(
    write_study: WriteStudy, sweep_here: Sweep, calls: list[str], tmp_path: Path
) -> None:
    # behind the camera, or in its view; the last settings of each contradict each other
    axes = {
        "scene.motion.position_m.2": [-0.6, 0.6],
        "key_frames.above": [600, 100],
        "key_frames.number": [50, 200],
    }
    path = write_study(base={"scene": SCENE}, axes=axes, steps=["simulate"])
    swept = sweep_here(path, tmp_path / "out")
    frame = polhode.load_study(tmp_path / "out")
    assert (swept.points, swept.failed) == (8, 5)
    assert frame["status"].tolist() == 4 * ["failed"] + 3 * ["done"] + ["failed"]
    assert all(reason.startswith("simulate: ") for reason in frame["reason"][:3])
    assert "settings: axes: key 'key_frames': number: 200 key frames are more than above: 100 frames" in set(
        frame["reason"]
    )
    assert sorted(swept.reasons.values()) == [2, 3]
    calls.clear()
    assert sweep_here(path, tmp_path / "out").stored == 8 and calls == []
    assert sweep_here(path, tmp_path / "out", again_failed=True).stored == 3
    assert set(frame["digest.point"][4:7]).isdisjoint(calls)
    assert set(frame["digest.point"][:3]) < set(calls)


def test_few_points_are_in_flight_however_many_there_are(
    write_study: WriteStudy, client: Client, tmp_path: Path
) -> None:
    study = open_study(write_study(axes={"seed": {"range": [0, 199], "count": 200}}, steps=[]))
    store, most = Store(tmp_path / "out"), []
    window = flow._Window(study, store, Cluster(client, 2, ""), array("l", range(200)))
    for _ in window.outcomes():
        most.append(len(window._points))
    assert len(most) == 200 and max(most) <= 2 * flow.READY_PER_WORKER
    assert all(store.read(study.point(number).address) for number in range(200))


def test_while_points_wait_for_one_sequence_others_are_looked_at(
    write_study: WriteStudy, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    axes = {BASELINES: [0.1, 0.2, 0.3], "backend.accel_psd": {"log_range": [1e-6, 1e-5], "count": 20}}
    study = open_study(write_study(base={"scene": SCENE}, axes=axes, steps=["simulate"]))
    submitted: list[str] = []

    def submit(function: Any, *words: Any, key: str, **more: Any) -> Any:
        submitted.append(key)
        return SimpleNamespace(key=key, status="pending")

    # a client whose tasks never end
    pending = cast(Client, SimpleNamespace(submit=submit, loop=client.loop))
    cluster = Cluster(pending, 1, "")
    window = flow._Window(study, Store(tmp_path), cluster, array("l", range(60)))
    monkeypatch.setattr(window, "_completed", SimpleNamespace(add=lambda future: None))
    assert list(window._fill()) == []
    kinds = [key.partition("-")[0] for key in submitted]
    assert kinds.count("sequence") == 3 and kinds.count("point") == 41


DISK_FULL = RunFailure("x.json: cannot be written (No space left on device)")
OTHER_CODE = work.OtherCode("node7 has other code")
KILLED = KilledWorker("point-1", cast(WorkerState, SimpleNamespace(address="tls://1")), 3)


def test_what_is_no_fault_of_a_point_ends_the_sweep_but_killed_workers_are_a_row(
    write_study: WriteStudy, client: Client, tmp_path: Path
) -> None:
    study, store = open_study(write_study(axes={"seed": [1]}, steps=[])), Store(tmp_path)
    window = flow._Window(study, store, Cluster(client, 1, ""), array("l", [0]))
    point = study.point(0)
    for error, said in (
        (DISK_FULL, "No space left on device); points"),
        (OTHER_CODE, "node7 has other code; was it changed meanwhile? Points that"),
        (None, "the scheduler was lost; points that are done are kept"),
    ):
        future = SimpleNamespace(
            status="error" if error else "cancelled", exception=lambda error=error: error
        )
        with pytest.raises(RunFailure) as failure:
            window._status(future, point, "")
        assert said in str(failure.value) and store.read(point.address) is None
    killed = SimpleNamespace(status="error", exception=lambda: KILLED)
    assert window._status(killed, point, "") == "failed"
    found = store.read(point.address)
    assert found is not None
    assert found["reason"] == "4 workers ended while computing it, perhaps for lack of memory"


@pytest.mark.usefixtures("coarse_keep_out")
@pytest.mark.parametrize("keep", ["whole", "summary"])
def test_a_study_of_existing_data_keeps_of_each_run_what_is_asked_for(
    keep: str,
    write_study: WriteStudy,
    sweep_here: Sweep,
    rendered_sequence: Path,
    finished: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def run_of_stored_files(config: Config, data: Path, folder: Path, progress: Progress) -> Any:
        assert config.runtime.workers == 1 and data == rendered_sequence
        shutil.copytree(finished, folder)
        return SimpleNamespace(status="degraded")

    monkeypatch.setattr(polhode.pipeline.run, "run", run_of_stored_files)
    steps = ["run", "evaluate", "plan"] if keep == "whole" else ["run", "evaluate"]
    few = {"members": 100, "horizon_s": 2.0, "confidence": 0.97}
    path = write_study(data=str(rendered_sequence), steps=steps, plan=few, keep=keep)
    swept = sweep_here(path, tmp_path / "out")
    assert (swept.points, swept.failed) == (1, 0), swept.reasons
    row = polhode.load_study(tmp_path / "out").iloc[0]
    assert row["verdict"] == "degraded" and row["run.frames"] == RENDERED_FRAMES
    assert 0.0 < row["evaluate.rmse_position_m"] < 0.05 and row["time.evaluate_s"] > 0.0
    if keep == "whole":
        assert row["plan.horizon_s"] == 2.0 and row["plan.keepout.volume_m3"] > 0.0
        left, farthest_m = (row[f"plan.truth.swept_body_{name}"] for name in ("left", "farthest_m"))
        assert left == (farthest_m > 0.0) and 0.0 <= farthest_m < 0.1
    kept = sorted((tmp_path / "out" / "runs").glob("*/*"))
    names = {each.name for each in kept}
    wanted = {"whole": {"run", "plan"}, "summary": {"summary.json", "metrics.json", "config.yaml"}}
    assert names == wanted[keep]
    if keep == "whole":
        run = next(each for each in kept if each.name == "run")
        assert polhode.load(run).status and (run / "metrics.json").is_file()
    assert list((tmp_path / "out" / "work").iterdir()) == []


def test_a_run_that_fails_is_a_row_whose_reason_names_no_folder(
    write_study: WriteStudy, sweep_here: Sweep, small_sequence: Path, tmp_path: Path
) -> None:
    swept = sweep_here(
        write_study(data=str(small_sequence), steps=["run", "evaluate"], keep="nothing"), tmp_path / "out"
    )
    assert swept.failed == 1 and list((tmp_path / "out" / "runs").iterdir()) == []
    row = polhode.load_study(tmp_path / "out").iloc[0]
    assert row["verdict"] == "failed" and row["reason"].startswith("run: ")
    assert str(tmp_path) not in row["reason"]


def test_a_study_compares_optimizers(write_study: WriteStudy, sweep_here: Sweep, tmp_path: Path) -> None:
    compare = {
        "solvers": ["gauss_newton"],
        "monte_carlo": {"motions": ["tumble"], "frames": [40], "landmarks": [300]},
    }
    path = write_study(base={"compare": compare}, axes={"compare.monte_carlo.seed": [3]}, steps=["compare"])
    assert sweep_here(path, tmp_path / "out").failed == 0
    row = polhode.load_study(tmp_path / "out").iloc[0]
    name = "compare.tumble-40-300.gauss_newton.cold0"
    assert row[f"{name}.status"] == "ok" and row[f"{name}.cost"] > 0.0
    assert row[f"time.{name}.wall_s"] > 0.0
