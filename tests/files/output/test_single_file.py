"""A file of a command replaces what the same command wrote, and nothing else."""

import os
from pathlib import Path

import pytest

from polhode.files.output.single_file import output_file, remove_all_partials
from polhode.runtime.errors import InputError


def is_own(path: Path) -> bool:
    return path.read_text() == "ours"


def place_of(path: Path) -> Path:
    return output_file(path, "report", "page.html", is_own)


def test_names_of_a_run_are_taken_only_where_there_is_a_run(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("{}")
    assert place_of(tmp_path / "mesh.ply") == tmp_path / "mesh.ply"
    (tmp_path / "summary.json").write_text('{"schema": "polhode-summary/1"}')
    for name in ("mesh.ply", "mesh_lod3.glb", "report.html", "pictures/mine/x.png"):
        with pytest.raises(InputError, match="belongs to the results of the run"):
            place_of(tmp_path / name)
    assert place_of(tmp_path / "mine" / "target.ply") == tmp_path / "mine" / "target.ply"


def test_a_name_that_leaves_no_room_for_a_temporary_one_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="File name too long"):
        place_of(tmp_path / f"{'x' * 245}.html")


def test_temporary_files_of_a_whole_folder_go_and_nothing_else_does(tmp_path: Path) -> None:
    live, dead = f".a.partial-{os.getpid()}.npz", (".R.problem.partial-999999999.npz", ".b.partial-999999999")
    others = (".bashrc", "x.partial-999999999.npz", ".c.partial-9x.npz")
    for name in (live, *dead, *others):
        (tmp_path / name).write_text("half")
    (tmp_path / ".d.partial-999999999").mkdir()
    (tmp_path / ".e.partial-999999999.npz").symlink_to(tmp_path / ".bashrc")
    remove_all_partials(tmp_path)
    remove_all_partials(tmp_path / "missing")
    left = {".d.partial-999999999", ".e.partial-999999999.npz", live, *others}
    assert {path.name for path in tmp_path.iterdir()} == left
