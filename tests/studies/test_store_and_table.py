"""Records on disk, and the table that is made of them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.errors import InputError
from polhode.studies.flat_metrics import flattened
from polhode.studies.steps import failed_record
from polhode.studies.store import Store
from polhode.studies.table import load_study, row_of, schema_of

ADDRESS = "ab" + 62 * "0"


def record(**other: Any) -> dict[str, Any]:
    return failed_record(ADDRESS, {"seed": 1}, "run: no motion") | other


def test_a_record_is_read_back(tmp_path: Path) -> None:
    store, written = Store(tmp_path), record()
    assert store.read(ADDRESS) is None
    store.write(written)
    assert store.read(ADDRESS) == written


@pytest.mark.parametrize("damage", ["truncated", "changed", "moved"])
def test_a_damaged_record_is_none(damage: str, tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write(record())
    file, address = store.record_file(ADDRESS), ADDRESS
    text = file.read_text()
    if damage == "truncated":
        file.write_text(text[:100])
    elif damage == "changed":
        content = json.loads(text)
        content["record"]["status"] = "done"
        file.write_text(json.dumps(content))
    else:
        address = "cd" + 62 * "0"
        store.record_file(address).parent.mkdir()
        file.rename(store.record_file(address))
    assert store.read(address) is None


def test_an_attempt_leaves_nothing_and_what_a_killed_one_left_is_removed(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.attempt() as folder:
        (folder / "half").write_text("")
    assert list((tmp_path / "work").iterdir()) == []
    (tmp_path / "work" / "attempt-1" / "run").mkdir(parents=True)
    (tmp_path / "work" / "notes.txt").write_text("the user's")
    store.clear_work()
    assert [each.name for each in (tmp_path / "work").iterdir()] == ["notes.txt"]


def test_metrics_are_flat_and_finite() -> None:
    values = {
        "error": {"median": 1.5, "max": float("inf")},
        "com": np.array([1.0, 2.0, 3.0]),
        "J": np.eye(3),
        "name": "ipopt",
        "words": 50 * "x",
        "holds": True,
        "data": {"a": 1},
    }
    assert flattened("run", values, frozenset({"data"})) == {
        "run.error.median": 1.5,
        "run.error.max": None,
        "run.com.0": 1.0,
        "run.com.1": 2.0,
        "run.com.2": 3.0,
        "run.name": "ipopt",
        "run.holds": True,
    }


def test_columns_have_the_type_of_their_values_and_results_follow_the_settings() -> None:
    rows = [
        row_of(0, record(metrics={"evaluate.e": 1, "run.k": 1.0, "run.ok": None})),
        row_of(1, record(metrics={"evaluate.e": 2.5, "run.n": 3, "run.ok": True})),
    ]
    schema = schema_of(rows)
    kinds = {field.name: str(field.type) for field in schema}
    assert kinds["evaluate.e"] == kinds["run.k"] == "double"
    assert (kinds["run.n"], kinds["run.ok"], kinds["verdict"], kinds["reason"]) == (
        "int64",
        "bool",
        "string",
        "string",
    )
    assert schema.names[:3] == ["point", "seed", "status"] and schema.names[-1] == "digest.point"
    assert (
        schema.names.index("run.n") < schema.names.index("evaluate.e") < schema.names.index("time.finished")
    )


def test_a_folder_that_is_no_study_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no study of polhode sweep"):
        load_study(tmp_path)
