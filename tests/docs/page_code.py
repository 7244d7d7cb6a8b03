"""Commands and code in the pages: what stands in fences, and commands in running text.

A fence of the language ``sh`` holds commands, ``python`` code, ``text`` neither. Its title says why the tests
leave it out, where they do: ``title="Not run by the tests: hours"``, which readers of the site see above it.
"""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = "../README.md"
PAGES = [README, *sorted(path.name for path in (ROOT / "docs").glob("*.md"))]
"""Relative to docs/"""
LEFT_OUT = "Not run by the tests: "
PROGRAMS = ("polhode", "python", "python3", "make", "pip", "pytest", "docker", "git", "mkdir", "npm", "cp")
"""First words of what is a command"""

_FENCE = re.compile(
    r"^(?P<indent> *)```(?P<language>\w*)(?: title=\"(?P<title>[^\"]*)\")?\n(?P<body>.*?)^(?P=indent)```$",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Fence:
    """A block of a page."""

    page: str
    line: int
    language: str
    title: str
    body: str

    @property
    def left_out(self) -> bool:
        """Whether the tests only check that the options exist."""
        return self.title.startswith(LEFT_OUT)

    def commands(self) -> list[str]:
        """Logical lines, without comments."""
        joined = re.sub(r"\\\n\s*", "", self.body)
        return [line.strip() for line in joined.splitlines() if shlex.split(line, comments=True)]


def fences(page: str) -> list[Fence]:
    """Of a page, in its order; raises ValueError for a fence that is not closed or has another title."""
    text, found = (ROOT / "docs" / page).read_text(), []
    for match in _FENCE.finditer(text):
        body = "\n".join(line.removeprefix(match["indent"]) for line in match["body"].splitlines())
        line = text.count("\n", 0, match.start()) + 1
        found.append(Fence(page, line, match["language"], match["title"] or "", body))
    if len(re.findall(r"^ *```", text, re.MULTILINE)) != 2 * len(found):
        raise ValueError(f"{page}: a fence is not closed, or its title is not one that the tests know")
    return found


def commands_in_text(page: str) -> Iterator[str]:
    """Commands with arguments in the running text and the tables of a page."""
    text = _FENCE.sub("", (ROOT / "docs" / page).read_text())
    for span in re.findall(r"(?<!`)`([^`\n]+(?:\n[^`\n]+)?)`(?!`)", text):
        command = " ".join(span.split()).replace("\\|", "|")
        if command.removeprefix(".venv/bin/").split()[0] in PROGRAMS and " " in command:
            yield command


def words_of(command: str) -> list[str]:
    """The words of a command, its program as the name alone; raises ValueError for pipes and the like."""
    words = shlex.split(command, comments=True)
    if any(word in ("|", "&&", ";", ">", "<") for word in words):
        raise ValueError(f"{command}: one command a line, without pipes and redirections")
    return [words[0].removeprefix(".venv/bin/"), *words[1:]]
