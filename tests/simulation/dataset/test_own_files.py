"""A dataset that ``simulate`` made is distinguished from a recording, whatever is copied into it."""

import shutil
from pathlib import Path

import pytest

from polhode.simulation.dataset.own_files import is_staged_file, is_whole, why_not_ours

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
    assert is_whole(dataset)
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
    assert is_whole(dataset)


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


def test_names_in_the_hidden_folder() -> None:
    for name in (".made_by", ".frames/3.done", ".frames/3/cam0/data/17.png", "mav0/cam0/data/17.png",
                 ".frames/3/truth0/.17.partial-44.npz"):  # fmt: skip
        assert is_staged_file(name)
    for name in (".frames/3/notes.txt", "notes.txt", "mav0/cam0/data/17.txt"):
        assert not is_staged_file(name)
