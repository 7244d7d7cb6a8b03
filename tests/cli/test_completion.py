"""Completion by the shells themselves: commands, options, values, and file names where nothing else fits."""

import shutil
import subprocess
from pathlib import Path

import pytest

from polhode.cli.completion import completion_script
from polhode.cli.main import COMMANDS, main
from polhode.cli.options import all_settings, options_of

BASH = """
source ./script
COMP_WORDS=({words}) COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 ))
{last}
_polhode
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("polhode ", [*COMMANDS, "--help", "--version"]),
        ("polhode ex", ["expect", "export"]),
        ("polhode run --pat", ["--patience-s"]),
        ("polhode run --backend.in", ["--backend.inertia"]),
        ("polhode run --backend.inertia ", ["second_moments", "ratios_axes"]),
        ("polhode run --json --qu", ["--quiet"]),
        ("polhode export --to u", ["urdf"]),
        ("polhode observability R --frame i", ["inertial"]),
        ("polhode evaluate --backend", []),
        ("polhode completion z", ["zsh"]),
        # the shell's own file names follow
        ("polhode run --data sam", []),
        ("polhode evaluate ", []),
    ],
)
def test_bash_offers(words: str, expected: list[str], tmp_path: Path) -> None:
    (tmp_path / "script").write_text(completion_script("bash", COMMANDS))
    last = "COMP_WORDS+=('') COMP_CWORD=$(( COMP_CWORD + 1 ))" if words.endswith(" ") else ""
    code = BASH.format(words=words, last=last)
    done = subprocess.run(["bash", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert (sorted(done.stdout.split()), done.stderr) == (sorted(expected), "")


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_shell_reads_its_script_which_has_every_option_of_every_command(
    shell: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "python" not in script and script.startswith(
        {"bash": "_polhode()", "zsh": "#compdef polhode"}[shell]
    )
    for command in COMMANDS.values():
        for option in (*options_of(command).values(), *all_settings()):
            assert option.is_positional or all(name in script for name in option.names)
    program = shutil.which(shell)
    if program is not None:
        (tmp_path / "script").write_text(script)
        subprocess.run([program, "-n", "script"], cwd=tmp_path, check=True)
