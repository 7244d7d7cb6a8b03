"""A dataset is made, resumed and replaced: whole or not at all; what is the user's stays."""

import multiprocessing
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import polhode.simulation.dataset.sequence as sequence
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Advance, Silent
from polhode.simulation.dataset.resumable_dataset import staged_dataset, why_not_ours
from polhode.simulation.dataset.sequence import simulate
from tests.simulation.small_scenes import files, small_scene

RIG = {"width_px": 48, "height_px": 36, "focal_px": 35.0}
SCENE = small_scene(frames=4, rig=RIG, render={"masks": True, "products": ["depth"], "samples": 1})


class _Listener:
    """Notes how many frames are rendered; after ``patience`` of them it raises."""

    def __init__(self, patience: int = 99, error: type[BaseException] = KeyboardInterrupt) -> None:
        self.patience, self.error = patience, error
        self.title, self.frames = "", 0

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Advance]:
        del total
        self.title = title
        if self.patience == 0:
            raise self.error

        def advance() -> None:
            self.frames += 1
            if self.frames == self.patience:
                raise self.error

        yield advance


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("whole") / "S"
    simulate(SCENE, 4, folder, Silent())
    return files(folder)


def test_an_interrupted_rendering_resumes_and_gives_the_same_bytes(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
    with pytest.raises(KeyboardInterrupt, match=r"interrupted; [2-4] of 4 pairs are kept, the same command"):
        simulate(SCENE, 4, tmp_path / "S", _Listener(2), workers=2)
    assert _names(tmp_path) == [".S.partial"]
    second = _Listener()
    simulate(SCENE, 4, tmp_path / "S", second, workers=1)
    kept = int(second.title.removeprefix("rendering (").split()[0])
    assert kept >= 2 and kept + second.frames == 4
    assert files(tmp_path / "S") == whole
    assert _names(tmp_path) == ["S"]


def _die_after_two_frames(folder: Path) -> None:
    class Dies(_Listener):
        @contextmanager
        def stage(self, title: str, total: int) -> Iterator[Advance]:
            with super().stage(title, total) as advance:
                yield lambda: os._exit(9) if self.frames == 2 else advance()

    simulate(SCENE, 4, folder, Dies())


def test_a_killed_rendering_resumes_and_gives_the_same_bytes(tmp_path: Path, whole: dict[str, bytes]) -> None:
    process = multiprocessing.get_context("fork").Process(
        target=_die_after_two_frames, args=(tmp_path / "S",)
    )
    process.start()
    process.join()
    assert process.exitcode == 9
    # What a kill leaves of a frame that was on its way to the disk.
    half = tmp_path / ".S.partial" / ".frames" / "3" / "cam0" / "data"
    half.mkdir(parents=True)
    (half / "junk.png").write_bytes(b"\x89PNG")
    last = _Listener()
    simulate(SCENE, 4, tmp_path / "S", last)
    assert (last.title, last.frames) == ("rendering (3 of 4 were there)", 1)
    assert files(tmp_path / "S") == whole


def test_a_damaged_frame_is_rendered_again(tmp_path: Path, whole: dict[str, bytes]) -> None:
    with pytest.raises(KeyboardInterrupt):
        simulate(SCENE, 4, tmp_path / "S", _Listener(3))
    image = next((tmp_path / ".S.partial/mav0/cam1/data").iterdir())
    image.write_bytes(image.read_bytes()[:40])
    next((tmp_path / ".S.partial/mav0/truth0").iterdir()).unlink()
    last = _Listener()
    simulate(SCENE, 4, tmp_path / "S", last)
    assert last.frames >= 2
    assert files(tmp_path / "S") == whole


@pytest.mark.parametrize("change", ["scene", "seed", "program"])
def test_a_staged_dataset_of_another_scene_or_program_is_cleared(
    tmp_path: Path, change: str, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    other = SCENE.model_copy(update={"interval_s": 0.25}) if change == "scene" else SCENE
    with monkeypatch.context() as patch:
        if change == "program":
            patch.setattr(sequence, "_program_digest", lambda: "an older one")
        with pytest.raises(KeyboardInterrupt):
            simulate(other, 5 if change == "seed" else 4, tmp_path / "S", _Listener(2))
    second = _Listener()
    simulate(SCENE, 4, tmp_path / "S", second)
    assert (second.title, second.frames) == ("rendering", 4)
    assert files(tmp_path / "S") == whole


@pytest.mark.parametrize(("patience", "error"), [(0, KeyboardInterrupt), (2, InputError)])
def test_an_interrupt_before_the_first_frame_or_a_late_input_error_leaves_nothing(
    tmp_path: Path, patience: int, error: type[BaseException]
) -> None:
    with pytest.raises(error, match=r"^interrupted$" if patience == 0 else None):
        simulate(SCENE, 4, tmp_path / "S", _Listener(patience, error))
    assert _names(tmp_path) == []


def test_the_old_dataset_exists_until_the_new_one_is_complete_and_nothing_of_it_after(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
    simulate(SCENE, 4, tmp_path / "S", Silent())
    with pytest.raises(KeyboardInterrupt):
        simulate(SCENE, 5, tmp_path / "S", _Listener(1), overwrite=True)
    assert files(tmp_path / "S") == whole
    shorter = SCENE.model_copy(update={"frames": 1})
    simulate(shorter, 4, tmp_path / "S", Silent(), overwrite=True)
    assert len(list((tmp_path / "S/mav0/cam0/data").iterdir())) == 1
    assert _names(tmp_path) == ["S"]


def test_only_a_dataset_or_an_empty_folder_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "S").mkdir()
    one = SCENE.model_copy(update={"frames": 1})
    simulate(one, 4, tmp_path / "S", Silent())
    with pytest.raises(InputError, match=r"exists: choose another folder or pass --overwrite"):
        simulate(one, 4, tmp_path / "S", Silent())
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "thesis.tex").write_text("x")
    for overwrite in (False, True):
        with pytest.raises(InputError, match="exists" if not overwrite else "it has no scene.yaml"):
            simulate(one, 4, tmp_path / "work", Silent(), overwrite=overwrite)
    assert _names(tmp_path / "work") == ["thesis.tex"]


def test_a_file_in_the_way_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "S").write_text("x")
    with pytest.raises(InputError, match="is a file"):
        simulate(SCENE, 4, tmp_path / "S", Silent(), overwrite=True)
    with pytest.raises(InputError, match="cannot write here"):
        simulate(SCENE, 4, tmp_path / "S" / "inside", Silent())
    assert (tmp_path / "S").read_text() == "x"


def test_two_simulations_of_one_dataset_do_not_mix(tmp_path: Path) -> None:
    with (
        staged_dataset(tmp_path / "S", False, "first"),
        pytest.raises(InputError, match="another polhode is at work"),
        staged_dataset(tmp_path / "S", False, "second"),
    ):
        pass


SAMPLE = Path(__file__).parents[3] / "examples" / "sample"


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """The shipped sample, made by an earlier version, with few of its images."""
    folder = tmp_path / "S"
    shutil.copytree(SAMPLE, folder, ignore=lambda _, names: [name for name in names if name.endswith(".png")])
    for index in (0, 1):
        images = sorted((SAMPLE / "mav0" / f"cam{index}" / "data").glob("*.png"))[:3]
        for image in images:
            shutil.copy(image, folder / "mav0" / f"cam{index}" / "data")
    return folder


def test_one_file_more_makes_it_the_users(dataset: Path) -> None:
    assert why_not_ours(dataset) == ""
    for name in (
        "notes.txt",
        "mav0/notes.txt",
        "mav0/cam0/data/left.png",
        "mav0/cam2/data/1.png",
        "flight.bag",
    ):
        (dataset / name).parent.mkdir(parents=True, exist_ok=True)
        (dataset / name).write_text("mine")
        assert why_not_ours(dataset) == f"it holds {name}"
        (dataset / name).unlink()
        if "cam2" in name:
            shutil.rmtree(dataset / "mav0/cam2")


def test_an_empty_folder_or_a_link_makes_it_the_users(dataset: Path, tmp_path: Path) -> None:
    (dataset / "mav0" / "imu0").mkdir()
    assert why_not_ours(dataset) == "it holds mav0/imu0"
    (dataset / "mav0" / "imu0").rmdir()
    (tmp_path / "disk").mkdir()
    shutil.rmtree(dataset / "mav0" / "cam1" / "data")
    (dataset / "mav0" / "cam1" / "data").symlink_to(tmp_path / "disk")
    assert why_not_ours(dataset) == "it holds mav0/cam1/data"


def test_a_recording_stays_one_with_the_scene_of_a_simulation(dataset: Path) -> None:
    """Its images have other times than the frames of the scene."""
    for index in (0, 1):
        data = dataset / "mav0" / f"cam{index}" / "data"
        for number, image in enumerate(sorted(data.iterdir())):
            image.rename(data / f"{1_700_000_000_123_456_789 + number}.png")
    assert why_not_ours(dataset).startswith("its scene.yaml is of other images than mav0/cam0/data/17000")


@pytest.mark.parametrize(
    ("name", "as_written"),
    [
        ("mav0/masks0/1600000000000000000.png", "render: {masks: true}"),
        ("mav0/truth1/1600000000000000000.npz", "render: {products: [depth]}"),
        ("mav0/inspector0/data.csv", "inspector: {profile: drift}"),
        ("mav0/wrench0/data.csv", "motion: {pushes: [{start_s: 1.0, duration_s: 1.0}]}"),
    ],
)
def test_folders_that_the_scene_does_not_ask_for_are_the_users(
    name: str, as_written: str, dataset: Path
) -> None:
    (dataset / name).parent.mkdir()
    (dataset / name).write_text("mine")
    assert why_not_ours(dataset) == f"its scene.yaml does not ask for {Path(name).parent}"
    (dataset / "scene.yaml").write_text(
        f"seed: 38\nscene: {{frames: 60, interval_s: 0.5, start_ns: 1600000000000000000, {as_written}}}\n"
    )
    assert why_not_ours(dataset) == ""


def test_a_scene_that_cannot_be_read_is_no_proof(dataset: Path) -> None:
    for text, reason in (
        ("seed: 1\n", "its scene.yaml has no scene"),
        ("scene: {frmes: 3}\n", "its scene.yaml cannot be read"),
        ("[" * 4000, "its scene.yaml cannot be read"),
    ):
        (dataset / "scene.yaml").write_text(text)
        assert why_not_ours(dataset) == reason
    (dataset / "scene.yaml").unlink()
    assert why_not_ours(dataset) == "it has no scene.yaml"
