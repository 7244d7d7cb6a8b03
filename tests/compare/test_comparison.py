"""The folder of a comparison."""

from pathlib import Path

from polhode.compare.comparison import claim


def test_what_a_killed_comparison_was_writing_is_removed(tmp_path: Path) -> None:
    folder = claim(tmp_path / "D")
    (folder / "problems" / "sample").mkdir()
    names = [f"{part}/.x.partial-999999999.npz" for part in ("rows", "problems", "problems/sample")]
    for name in (*names, "problems/x.npz"):
        (folder / name).write_text("half")
    claim(tmp_path / "D")
    assert not any((folder / name).exists() for name in names)
    assert (folder / "problems/x.npz").exists()
