"""A study whose points have invented results, stored as workers would store them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from polhode.files.output.marked_folder import claim
from polhode.studies.steps import DONE, failed_record
from polhode.studies.store import Store
from polhode.studies.study import OpenStudy, open_study
from polhode.studies.table import COMMAND, FILES, STUDY, TABLE, write_table
from tests.studies.conftest import SCENE

Outcome = Callable[[int, dict[str, Any]], dict[str, Any]]
"""Number and settings of a point -> what its record has beside an empty one"""
StoreStudy = Callable[..., tuple[OpenStudy, Path]]


def of_metrics(**metrics: float) -> dict[str, Any]:
    """A record of a run with these results; "__" stands for a dot."""
    found = {name.replace("__", "."): value for name, value in metrics.items()}
    return {"status": DONE, "reason": None, "verdict": "ok", "metrics": found}


@pytest.fixture
def store_study(tmp_path: Path) -> StoreStudy:
    """The study and the folder with its table."""

    def stored(outcome: Outcome, **content: Any) -> tuple[OpenStudy, Path]:
        path, folder = tmp_path / "study.yaml", tmp_path / "out"
        path.write_text(yaml.safe_dump({"base": {"scene": SCENE}, **content}, sort_keys=False))
        study, store = open_study(path), Store(folder)
        claim(folder, COMMAND, FILES)
        for number in range(study.count):
            point = study.point(number)
            store.write(failed_record(point.address, point.values, "") | outcome(number, point.values))
        (folder / STUDY).write_text(study.text())
        write_table(study, store, folder / TABLE)
        return study, folder

    return stored
