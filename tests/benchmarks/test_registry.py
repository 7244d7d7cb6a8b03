"""Every benchmark is in the registry, and a stored result knows whether it is old."""

import subprocess
from pathlib import Path

import pytest

from benchmarks import record
from benchmarks.command import ROOT
from benchmarks.registry import BENCHMARKS, CODE, chosen, code_of


def test_every_command_is_in_the_registry_and_the_other_way_round() -> None:
    folder = ROOT / "benchmarks"
    modules = {
        ".".join(path.relative_to(folder).with_suffix("").parts).removesuffix(".__main__")
        for path in folder.glob("*/*.py")
        if '__name__ == "__main__"' in path.read_text()
    }
    assert modules == {each.module for each in BENCHMARKS}
    assert len({each.name for each in BENCHMARKS}) == len(BENCHMARKS)
    assert all(each.prints for each in BENCHMARKS)


def test_every_page_quotes_the_command_that_feeds_it() -> None:
    for each in BENCHMARKS:
        if each.page:
            text = (ROOT / each.page).read_text()
            assert f"benchmarks.{each.module}" in text or each.page == "README.md", each.name


def test_a_name_or_a_topic_chooses_and_another_word_is_refused() -> None:
    assert [each.name for each in chosen(("bound",))] == ["bound"]
    assert {each.topic for each in chosen(("mapping",))} == {"mapping"}
    assert chosen(()) == list(BENCHMARKS)
    with pytest.raises(SystemExit, match="no such benchmark; the topics are"):
        chosen(("mappings",))


def test_the_folders_that_a_result_depends_on_exist() -> None:
    assert set(CODE) == {each.topic for each in BENCHMARKS}
    for topic in CODE:
        assert all((ROOT / path).exists() for path in code_of(f"benchmarks.{topic}.module"))


def test_small_versions_need_no_stored_runs() -> None:
    keepout = next(each for each in BENCHMARKS if each.name == "keepout")
    assert keepout.arguments(short=True) is None
    scale = next(each for each in BENCHMARKS if each.name == "fusion_scale")
    assert scale.arguments(short=True) == ["--short"] and scale.missing(short=True) == ""


def test_a_result_is_old_when_its_code_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*words: str) -> None:
        identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", *identity, *words], cwd=tmp_path, check=True, capture_output=True)

    def commit(file: str, text: str) -> None:
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text(text)
        git("add", "-A")
        git("commit", "-m", file)
        for cached in (record.provenance, record.last_change):
            cached.cache_clear()

    monkeypatch.setattr(record, "ROOT", tmp_path)
    git("init")
    commit("backend/a.py", "1")
    made = record.provenance(("backend",))
    assert record.state(made, ("backend",)).startswith("current, made at ")
    commit("docs/a.md", "1")
    assert record.state(made, ("backend",)).startswith("current")
    commit("backend/a.py", "2")
    assert "backend changed in" in record.state(made, ("backend",))
    other = {**record.provenance(("backend",)), "configuration": "another"}
    assert "with another default configuration" in record.state(other, ("backend",))
    assert "uncommitted" in record.state({**made, "changed": True}, ("backend",))
    assert record.state(None, ("backend",)) == "recorded before records named their commit"
