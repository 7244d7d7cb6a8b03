"""Whether the links that leave the site still answer: ``make docs-links``.

It needs a network, so no test runs it. Prints each address that does not answer, with the pages that name it,
and ends with 1 if there is one.
"""

import re
import sys
import urllib.error
import urllib.request
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT_S = 20.0
WANTS_NO_PROGRAM = (401, 403, 405, 429)
"""HTTP statuses of servers that are there, but refuse a program"""
_ADDRESS = re.compile(r"https?://[^\s)>\"'`\]]+")


def fault_of(address: str) -> str:
    """What is wrong with an address; empty: it answers."""
    request = urllib.request.Request(address, headers={"User-Agent": "polhode docs"})  # noqa: S310
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S):  # noqa: S310
            return ""
    except urllib.error.HTTPError as error:
        return "" if error.code in WANTS_NO_PROGRAM else f"HTTP {error.code}"
    except OSError as error:
        return str(error)


def main() -> int:
    """Check them all, a few at a time."""
    pages: dict[str, set[str]] = defaultdict(set)
    for page in (*(ROOT / "docs").glob("*.md"), *ROOT.glob("*.md")):
        for address in _ADDRESS.findall(page.read_text()):
            pages[address.rstrip(".,;:")].add(page.name)
    with ThreadPoolExecutor(8) as pool:
        faults = dict(zip(pages, pool.map(fault_of, pages), strict=True))
    for address, fault in faults.items():
        if fault:
            print(f"{address}: {fault} ({', '.join(sorted(pages[address]))})")
    print(f"{sum(not fault for fault in faults.values())} of {len(faults)} links answer")
    return 1 if any(faults.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
