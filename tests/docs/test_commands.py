"""Every command of every page is run, in the order of the page, or, where the page says why not, checked.

The commands run on small data (``world``), some with further options that make them quick (``QUICK``). A run
that several pages show is made once; where it is shown again, its options are checked and it is copied.
Commands in running text are checked: their options exist, and so does what they name in the repository.
"""

import runpy
import shutil
import sys
from pathlib import Path

import pytest

from benchmarks.end_to_end.report_page import browser_path
from tests.docs.command_check import check, check_mention
from tests.docs.conftest import QUICK_RUN, StoredRuns, succeed
from tests.docs.page_code import LEFT_OUT, PAGES, PROGRAMS, Fence, commands_in_text, fences, words_of
from tests.docs.world import provide

OWN_TESTS = {"api.md": "tests/pipeline/test_api.py runs its code from top to bottom"}
QUICK_SIMULATION = (
    *("--scene.frames", "2", "--scene.truth-horizon-s", "0", "--runtime.workers", "1"),
    *("--scene.rig.width-px", "64", "--scene.rig.height-px", "48", "--scene.rig.focal-px", "50"),
    *("--scene.render.samples", "1", "--scene.render.bounces", "0"),
)
QUICK = {
    "plan": ("--horizon", "2", "--members", "100", "--confidence", "0.97"),
    "export": ("--pieces", "1", "--horizon", "4"),
}
"""Options that are appended to a command, by its name"""
BROWSER_MODULES = ("benchmarks.end_to_end.report_picture", "benchmarks.end_to_end.report_page")
"""They draw a page in a browser of the system"""
LANGUAGES = ("sh", "python", "text", "yaml", "json", "xml", "sql", "cpp", "")


def is_run(fence: Fence) -> bool:
    """Whether the tests run what stands in a fence."""
    return fence.language in ("sh", "python") and not fence.left_out


@pytest.mark.parametrize("page", PAGES)
def test_commands_stand_in_fences_of_the_shell(page: str) -> None:
    for fence in fences(page):
        assert fence.language in LANGUAGES, f"{page}:{fence.line}: {fence.language}"
        assert not fence.title or fence.left_out, f"{page}:{fence.line}: a title says {LEFT_OUT!r} and why"
        if fence.language != "sh":
            first = [
                line.split()[0].removeprefix(".venv/bin/") for line in fence.body.splitlines() if line.split()
            ]
            is_usage = "SOURCE..." in fence.body
            assert is_usage or not set(first) & set(PROGRAMS), f"{page}:{fence.line}: commands are sh"


@pytest.mark.parametrize("page", [page for page in PAGES if any(f.left_out for f in fences(page))])
def test_what_is_left_out_could_be_run(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for fence in fences(page):
        if fence.left_out and fence.language == "sh":
            for command in fence.commands():
                check(words_of(command), monkeypatch)


@pytest.mark.parametrize("page", [page for page in PAGES if any(commands_in_text(page))])
def test_commands_in_the_text_could_be_run(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for command in commands_in_text(page):
        check_mention(words_of(command), monkeypatch)


@pytest.mark.usefixtures("coarse_keep_out")
@pytest.mark.parametrize(
    "page", [page for page in PAGES if page not in OWN_TESTS and any(map(is_run, fences(page)))]
)
def test_the_page_runs_from_top_to_bottom(
    page: str, runs: StoredRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    without_browser: list[str] = []
    for fence in fences(page):
        if fence.left_out:
            continue
        if fence.language == "sh":
            for command in fence.commands():
                words = words_of(command)
                if needs_missing_browser(words):
                    check(words, monkeypatch)
                    without_browser.append(command)
                else:
                    run_command(words, runs, monkeypatch)
        elif fence.language == "python":
            run_code(fence, tmp_path)
    if without_browser:
        pytest.skip(f"no Chromium: all else of {page} ran, not {'; '.join(without_browser)}")


def needs_missing_browser(words: list[str]) -> bool:
    """Whether a command draws a page in a browser, and the system has none."""
    return words[:1] == ["python"] and words[2] in BROWSER_MODULES and browser_path() is None


def run_command(words: list[str], runs: StoredRuns, patch: pytest.MonkeyPatch) -> None:
    """Provide what the command reads, then run it in this process."""
    for before, word in zip(["", *words], words, strict=False):
        if before not in ("-o", "--output"):
            provide(word, Path.cwd(), runs.sequence, runs.plain)
    if words[0] == "polhode":
        run_polhode(words[1:], runs, patch)
    elif words[0] == "python":
        run_python(words[1:], patch)
    else:
        raise AssertionError(f"{' '.join(words)}: give a title that begins with {LEFT_OUT!r}")


def run_polhode(words: list[str], runs: StoredRuns, patch: pytest.MonkeyPatch) -> None:
    """Run it; what several pages show on the same pairs (``StoredRuns``) is run only once for all of them."""
    stored = runs.of(words)
    if stored is not None:
        check(["polhode", *words], patch)
        shutil.copytree(stored, words[words.index("-o") + 1], dirs_exist_ok=True)
    elif words[0] == "run":
        succeed(["run", *QUICK_RUN, *words[1:]])
    elif words[0] == "simulate":
        succeed([*words, *QUICK_SIMULATION])
        # a run needs more than two small pairs
        simulated = Path(words[words.index("-o") + 1])
        shutil.rmtree(simulated)
        simulated.symlink_to(runs.sequence)
    else:
        succeed([*words, *QUICK.get(words[0], ())])
    if "-o" in words:
        assert Path(words[words.index("-o") + 1]).exists(), " ".join(words)


def run_python(words: list[str], patch: pytest.MonkeyPatch) -> None:
    """``-m module`` with its arguments; it must end with 0."""
    assert words[0] == "-m", f"python {words[0]}: name a module"
    patch.setattr(sys, "argv", words[1:])
    code = 0
    try:
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    except SystemExit as stop:
        code = int(stop.code or 0)
    assert code == 0, f"{' '.join(words)}: exit code {code}"


def run_code(fence: Fence, folder: Path) -> None:
    """The code of a fence, as a script of its own."""
    script = folder / f"{fence.page}_{fence.line}.py"
    script.write_text(fence.body)
    runpy.run_path(str(script), run_name=f"docs_{fence.line}")
    script.unlink()
