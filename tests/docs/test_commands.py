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

from tests.docs.command_check import check, check_mention
from tests.docs.conftest import QUICK_RUN, StoredRuns, succeed
from tests.docs.page_code import LEFT_OUT, PAGES, PROGRAMS, commands_in_text, fences, words_of
from tests.docs.world import provide
from tests.front_end_results import SharedFrontEnd

OWN_TESTS = {"api.md": "tests/pipeline/test_api_page.py runs its code from top to bottom"}
QUICK = {
    "run": QUICK_RUN,
    "predict": ("--horizon", "4"),
    "plan": ("--horizon", "2", "--members", "100", "--confidence", "0.97"),
    "export": ("--pieces", "1", "--horizon", "4"),
    "compare": ("--compare.solvers", "gauss_newton"),
    "simulate": (
        *("--scene.frames", "2", "--scene.truth-horizon-s", "0", "--runtime.workers", "1"),
        *("--scene.rig.width-px", "64", "--scene.rig.height-px", "48", "--scene.rig.focal-px", "50"),
        *("--scene.render.samples", "1", "--scene.render.bounces", "0"),
    ),
}
"""Options that are added to a command, by its name"""
RUN = {
    page: [each for each in fences(page) if each.language in ("sh", "python") and not each.left_out]
    for page in PAGES
    if page not in OWN_TESTS
}
"""Fences that the tests run"""


@pytest.mark.parametrize("page", PAGES)
def test_commands_could_be_run_as_they_stand(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for command in commands_in_text(page):
        check_mention(words_of(command), monkeypatch)
    for fence in fences(page):
        assert not fence.title or fence.left_out, f"{page}:{fence.line}: a title says {LEFT_OUT!r} and why"
        if fence.language == "sh" and fence.left_out:
            for command in fence.commands():
                check(words_of(command), monkeypatch)
        elif fence.language != "sh" and "SOURCE..." not in fence.body:
            first = {line.split()[0].removeprefix(".venv/bin/") for line in fence.body.splitlines() if line}
            assert not first & set(PROGRAMS), f"{page}:{fence.line}: commands stand in fences of sh"


@pytest.mark.usefixtures("coarse_keep_out")
@pytest.mark.parametrize("page", [page for page, found in RUN.items() if found])
def test_the_page_runs_from_top_to_bottom(
    page: str,
    runs: StoredRuns,
    front_end_once: SharedFrontEnd,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    with front_end_once():
        for fence in RUN[page]:
            if fence.language == "sh":
                for command in fence.commands():
                    run_command(words_of(command), runs, monkeypatch)
            else:
                script = tmp_path / f"line_{fence.line}.py"
                script.write_text(fence.body)
                runpy.run_path(str(script), run_name=script.stem)
                script.unlink()


def run_command(words: list[str], runs: StoredRuns, patch: pytest.MonkeyPatch) -> None:
    """Provide what the command reads, then run it in this process.

    What several pages show on the same pairs (``StoredRuns``) is run only once for all of them.
    """
    for before, word in zip(["", *words], words, strict=False):
        if before not in ("-o", "--output"):
            provide(word, Path.cwd(), runs.sequence, runs.plain)
    if words[:2] == ["python", "-m"]:
        patch.setattr(sys, "argv", words[2:])
        code: object = 0
        try:
            runpy.run_module(words[2], run_name="__main__", alter_sys=True)
        except SystemExit as stop:
            code = stop.code or 0
        assert code == 0, f"{' '.join(words)}: exit code {code}"
        return
    assert words[0] == "polhode", f"{' '.join(words)}: give a title that begins with {LEFT_OUT!r}"
    name, output = words[1], Path(words[words.index("-o") + 1]) if "-o" in words else None
    stored = runs.of(words[1:])
    if stored is not None and output is not None:
        check(words, patch)
        shutil.copytree(stored, output, dirs_exist_ok=True)
    else:
        # what a page sets of a run stays; of other commands it is shortened
        quick = QUICK.get(name, ())
        succeed([name, *quick, *words[2:]] if name == "run" else [*words[1:], *quick])
    if name == "simulate" and output is not None:
        # a run needs more than two small pairs
        shutil.rmtree(output)
        output.symlink_to(runs.sequence)
    assert output is None or output.exists(), " ".join(words)
