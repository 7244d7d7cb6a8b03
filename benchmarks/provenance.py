"""What made a stored result: the commit, the configuration and the machine; and whether it is still current.

A result is old when the code that it depends on or the default configuration has changed since the commit
that it names, or when that code had uncommitted changes.
"""

import hashlib
import platform
import subprocess
from collections import Counter
from collections.abc import Iterable
from datetime import datetime
from functools import cache
from typing import Any

from benchmarks.command import ROOT

Provenance = dict[str, Any]


@cache
def provenance(code: tuple[str, ...]) -> Provenance:
    """Of a result that is measured now; ``code``: the folders that it depends on."""
    return {
        "commit": _git("rev-parse", "HEAD"),
        "changed": bool(_git("status", "--porcelain", "--untracked-files=no", "--", *code)),
        "configuration": default_configuration(),
        "machine": f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}",
        "time": datetime.now().astimezone().isoformat(timespec="minutes"),
    }


@cache
def default_configuration() -> str:
    """A digest of the default configuration, which a case changes only in what it names."""
    from polhode.config import Config
    from polhode.config.loader import dump_config

    return hashlib.sha256(dump_config(Config()).encode()).hexdigest()[:12]


def state(made: Provenance | None, code: tuple[str, ...]) -> str:
    """Whether a stored result is current, as a sentence without its full stop."""
    if not made or not made.get("commit"):
        return "recorded before records named their commit"
    short = made["commit"][:9]
    if made["changed"]:
        return f"old: made with uncommitted changes on {short}"
    last = last_change(code)
    if last and not _is_ancestor(last, made["commit"]):
        return f"old: made at {short}, and {', '.join(code)} changed in {last[:9]} since then"
    if made["configuration"] != default_configuration():
        return f"old: made at {short} with another default configuration ({made['configuration']})"
    return f"current, made at {short}"


def print_states(results: Iterable[Provenance | None], code: tuple[str, ...]) -> None:
    """A line for each state that some of the results have, with their number."""
    counts = Counter(state(made, code) for made in results)
    for words, count in counts.most_common():
        print(f"{count} stored result{'s' if count > 1 else ''}: {words}.")


@cache
def last_change(code: tuple[str, ...]) -> str:
    """The last commit that touched the folders; empty outside of a repository."""
    return _git("rev-list", "-1", "HEAD", "--", *code)


@cache
def _is_ancestor(earlier: str, later: str) -> bool:
    command = ["git", "merge-base", "--is-ancestor", earlier, later]
    return subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode == 0


def _git(*words: str) -> str:
    """What git prints; empty where it fails."""
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
