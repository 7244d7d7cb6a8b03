"""The corpus: by the seed alone, apart from what the tests of the methods show, never mixed with another."""

import errno
import shutil
from pathlib import Path

import numpy as np
import pytest

import polhode.cli.main as command_line
from polhode.config.loader import load_config
from polhode.config.train_settings import Corpus
from polhode.files.output.place import unwritable
from polhode.records.dataset import open_sequence
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.frame_renderer import read_products
from polhode.simulation.dataset.sequence import SCENE_FILE
from polhode.train.corpus import (
    FIRST_BODY_SEED,
    NOTE,
    random_scene,
    render_corpus,
    require_corpus,
    scene_folder,
    split,
)

ROOT = Path(__file__).parents[2]
FEW_FAMILIES = ("features.yaml", "depth.yaml")
SURFACE = tuple(f"surface{part}.yaml" for part in ("_first", "", "_wide", "_more", "_settle"))
SHIPPED = (*FEW_FAMILIES, *SURFACE)


def test_scenes_keep_to_the_ranges_and_depend_on_the_seed_and_their_number_alone() -> None:
    corpus = Corpus(scenes=10)
    scenes = [random_scene(corpus, index) for index in range(5)]
    assert scenes[3] == random_scene(Corpus(scenes=50, folder="elsewhere"), 3)
    assert scenes[3] not in (scenes[2], random_scene(Corpus(scenes=4, seed=1), 3))
    for index, scene in enumerate(scenes):
        turn_deg = np.linalg.norm(scene.motion.spin_rpm) * 6.0 * scene.interval_s
        assert corpus.turn_deg[0] <= turn_deg <= corpus.turn_deg[1]
        disparity_px = scene.rig.baseline_m * scene.rig.focal_px / scene.motion.position_m[2]
        assert corpus.disparity_px[0] <= disparity_px <= corpus.disparity_px[1]
        assert scene.body.seed == FIRST_BODY_SEED + index
        sun = np.array(scene.light.sun_direction_N)
        phase_deg = np.rad2deg(np.arccos(-sun[2] / np.linalg.norm(sun)))
        assert corpus.sun_phase_deg[0] - 1e-6 <= phase_deg <= corpus.sun_phase_deg[1] + 1e-6


@pytest.mark.parametrize("name", SHIPPED)
def test_what_ships_is_never_trained_on_what_tests_show(name: str) -> None:
    train = load_config(ROOT / "configs" / "train" / name).train
    assert train is not None
    for corpus in (train.corpus, *(more.corpus for more in train.surface.more)):
        assert corpus.texture == "drawn"
    assert FIRST_BODY_SEED >= 1000
    if name in FEW_FAMILIES:
        assert not {"truss", "dish"} & set(train.corpus.families)


def test_no_body_is_on_both_sides_of_the_split_and_some_are_held_out() -> None:
    halves = split(Corpus(scenes=40))
    assert sorted(halves.training + halves.validation) == list(range(40))
    assert not set(halves.training) & set(halves.validation)
    assert len(halves.validation) == 5
    with pytest.raises(InputError, match=r"hold out none: lower validation_every"):
        split(Corpus(scenes=4, validation_every=8))


def test_scenes_are_ordinary_sequences_with_the_truth_of_pixels(tiny_corpus: Corpus) -> None:
    folder = scene_folder(tiny_corpus, 1)
    sequence = open_sequence(folder)
    assert len(sequence) == tiny_corpus.frames
    products = read_products(folder / "mav0" / "truth0" / f"{sequence.timestamps_ns[0]}.npz")
    assert products.mask is not None
    assert 200 * 200 * 0.5 < products.mask.sum() < 300 * 300
    assert all(each is not None for each in (products.depth, products.normals, products.shadow))


def test_only_missing_scenes_are_rendered_and_a_folder_of_other_scenes_is_refused(
    tiny_corpus: Corpus,
) -> None:
    there = [scene_folder(tiny_corpus, i) / SCENE_FILE for i in range(2)]
    before = [path.stat().st_mtime_ns for path in there]
    render_corpus(tiny_corpus, Silent(), 1)
    assert [path.stat().st_mtime_ns for path in there] == before
    other = tiny_corpus.model_copy(update={"turn_deg": (20.0, 25.0), "seed": 9})
    with pytest.raises(InputError, match=r"contains a corpus with another seed, turn_deg"):
        render_corpus(other, Silent(), 1)


def tree(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else b""
        for path in folder.rglob("*")
    }


@pytest.mark.parametrize("key", ["output", "corpus.folder", "depth.cache"])
def test_nothing_is_written_into_a_dataset(
    key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "seq" / "mav0" / "cam0" / "data").mkdir(parents=True)
    (tmp_path / "c.yaml").write_text("train: {task: depth}\n")
    before = tree(tmp_path)
    for place in ("seq/mav0/cam0/data", "seq/mav0/new/one"):
        assert command_line.main(["train", "c.yaml", f"--train.{key}", place]) == 2
        stderr = capsys.readouterr().err
        assert f"train.{key}: {place}: inside the dataset" in stderr and stderr.count("\n") == 1
        assert " -o" not in stderr
        assert tree(tmp_path) == before


@pytest.mark.parametrize("key", ["output", "corpus.folder", "depth.cache"])
def test_a_place_that_is_full_is_refused_before_anything_is_written(
    key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(folder: Path, shown: Path) -> None:
        if "full/place" in str(shown):
            raise unwritable(shown, OSError(errno.ENOSPC, "No space left on device"))

    for module in ("files.output.marked_folder", "train.corpus", "train.run"):
        monkeypatch.setattr(f"polhode.{module}.require_writable", refuse)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.yaml").write_text("train: {task: depth}\n")
    assert command_line.main(["train", "c.yaml", f"--train.{key}", "full/place"]) == 2
    stderr = capsys.readouterr().err
    assert f"train.{key}: full/place: cannot write here (No space left on device)" in stderr
    assert " -o" not in stderr
    assert [path.name for path in tmp_path.iterdir()] == ["c.yaml"]


def test_scenes_without_their_note_are_refused(
    training_file: Path, tiny_corpus: Corpus, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "corpus"
    shutil.copytree(tiny_corpus.folder, folder)
    (folder / NOTE).unlink()
    before = tree(folder)
    for seed in ("3", "9"):
        words = [f"--train.corpus.folder={folder}", f"--train.corpus.seed={seed}"]
        assert command_line.main(["train", str(training_file), *words]) == 2
        stderr = capsys.readouterr().err
        assert f"contains 0000 and no {NOTE}" in stderr and stderr.count("\n") == 1
    assert tree(folder) == before and not (tmp_path / "out").exists()


def test_what_a_killed_process_left_of_the_note_is_no_scene(tmp_path: Path) -> None:
    (tmp_path / ".corpus.partial-999999999.yaml").write_text("half")
    require_corpus(Corpus(folder=str(tmp_path)))
