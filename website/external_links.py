"""Whether the links that leave the site still answer: ``make docs-links``.

It needs a network, so no test runs it. Prints each address that does not answer, with the pages that name it,
and ends with 1 if there is one.
"""

import re
import sys
import urllib.error
import urllib.request
from collections import defaultdict
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT_S = 20.0
_ADDRESS = re.compile(r"https?://[^\s)>\"'`\]]+")


def addresses(pages: Iterable[Path]) -> dict[str, list[str]]:
    """Address -> names of the pages that contain it."""
    found: dict[str, list[str]] = defaultdict(list)
    for page in pages:
        for address in _ADDRESS.findall(page.read_text()):
            found[address.rstrip(".,;:")].append(page.name)
    return dict(found)


def answer(address: str) -> str:
    """What is wrong with an address; empty: it answers."""
    request = urllib.request.Request(address, method="GET", headers={"User-Agent": "polhode docs"})  # noqa: S310
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S):  # noqa: S310
            return ""
    except urllib.error.HTTPError as error:
        # the server is there, but wants no program to read it
        return "" if error.code in (401, 403, 405, 429) else f"HTTP {error.code}"
    except (urllib.error.URLError, TimeoutError, OSError) as error:
        return str(error)


def main() -> int:
    """Check them all, a few at a time."""
    found = addresses([*sorted((ROOT / "docs").glob("*.md")), *sorted(ROOT.glob("*.md"))])
    with ThreadPoolExecutor(8) as pool:
        answers = dict(zip(found, pool.map(answer, found), strict=True))
    for address, wrong in answers.items():
        if wrong:
            print(f"{address}: {wrong} ({', '.join(sorted(set(found[address])))})")
    print(f"{sum(not wrong for wrong in answers.values())} of {len(found)} links answer")
    return 1 if any(answers.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
