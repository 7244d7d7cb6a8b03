"""Let a study count points that another machine computed, with other versions of libraries.

    python -m benchmarks.adopt STUDY.yaml OTHER [OTHER ...] -o DIR

``polhode sweep`` computes a point again wherever the code or a library is another one. Where that would
cost hours, this command stores the points of OTHER, a folder of the same study, as those of DIR. Then
``polhode sweep STUDY.yaml -o DIR`` computes what is missing, and writes table and page. What each row was
made with stays in its columns ``version.*`` and ``digest.code``.
"""

import json
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from benchmarks.command import command
from polhode.errors import InputError
from polhode.output.marked_folder import claim
from polhode.studies.store import Store
from polhode.studies.study import OpenStudy, open_study
from polhode.studies.table import COMMAND, FILES, STUDY


def main(
    study: Positional[Annotated[Path, arg(metavar="STUDY.yaml", help="The study.")]],
    others: Positional[Annotated[tuple[Path, ...], arg(metavar="OTHER", help="Folders of it.")]],
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR", help="The folder that lacks points.")],
) -> None:
    """Store the points of the other folders that DIR lacks, and say how many are still missing."""
    try:
        wanted, theirs = open_study(study), [opened(each) for each in others]
    except InputError as error:
        raise SystemExit(str(error)) from None
    for other, own in zip(others, theirs, strict=True):
        if own.base != wanted.base or own.settings.steps != wanted.settings.steps:
            raise SystemExit(f"{other}: its study has another base or other steps than {study}")
    output.mkdir(parents=True, exist_ok=True)
    claim(output, COMMAND, FILES)
    for other in others:
        print(f"{adopted(wanted, other, Store(output))} points of {other}")
    missing = sum(Store(output).read(wanted.point(k).address) is None for k in range(wanted.count))
    print(f"{missing} of {wanted.count} points are missing")


def opened(folder: Path) -> OpenStudy:
    """The study of a folder. Raises InputError."""
    return open_study(folder / STUDY, check=False)


def adopted(study: OpenStudy, other: Path, store: Store) -> int:
    """Store the points of a folder that ``store`` lacks. Returns their number."""
    points = {_key(point.values): point for point in map(study.point, range(study.count))}
    count = 0
    for record in Store(other).records():
        point = points.get(_key(record["settings"]))
        if point is not None and store.read(point.address) is None:
            store.write(record | {"address": point.address})
            count += 1
    return count


def _key(values: dict[str, Any]) -> str:
    return json.dumps(values, sort_keys=True)


if __name__ == "__main__":
    command(main)
