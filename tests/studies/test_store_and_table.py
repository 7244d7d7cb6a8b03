"""Records on disk, and the table that is made of them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.runtime.errors import InputError
from polhode.studies import store as store_module
from polhode.studies.flat_metrics import as_json, flattened
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


def address(number: int) -> str:
    return f"{number:064x}"


def test_packed_records_are_read_back_in_any_order_and_leave_no_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store_module, "PACKED_AT_ONCE", 4)
    store = Store(tmp_path)
    written = {address(k): record(address=address(k), verdict=f"v{k}") for k in range(11)}
    for each in written.values():
        store.write(each)
    assert Store(tmp_path).has_records()
    store.pack(first=[address(7), address(99), address(3)])
    assert not list((tmp_path / "points").iterdir())
    for again in (store, Store(tmp_path)):
        assert again.has_records() and again.read(address(99)) is None
        assert {key: again.read(key) for key in reversed(written)} == written
    order = [each["address"] for each in store.records()]
    assert order[:3] == [address(7), address(3), address(0)] and sorted(order) == sorted(written)


def test_a_record_that_is_computed_again_replaces_the_packed_one(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for k in range(3):
        store.write(record(address=address(k)))
    store.pack()
    store.write(record(address=address(1), verdict="ok"))
    assert [each["verdict"] for each in store.records()] == [None, "ok", None]
    store.pack(without={address(0)})
    assert [each["verdict"] for each in Store(tmp_path).records()] == ["ok", None]
    assert Store(tmp_path).read(address(0)) is None


def test_a_damaged_file_of_packed_records_is_named(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write(record())
    store.pack()
    packed = tmp_path / "records.parquet"
    packed.write_bytes(packed.read_bytes()[:-9])
    with pytest.raises(InputError, match=r"records.parquet cannot be read .*; remove it"):
        Store(tmp_path).read(ADDRESS)


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


def test_what_was_measured_is_stored_as_json_has_it() -> None:
    found = as_json({"a": np.arange(2.0), "b": (np.float64(np.nan), True), "c": {"d": None, "e": "x"}})
    assert found == {"a": [0.0, 1.0], "b": [None, True], "c": {"d": None, "e": "x"}}
    json.dumps(found, allow_nan=False)
    with pytest.raises(TypeError, match="no number, text or list of them: object"):
        as_json({"a": [object()]})
    with pytest.raises(TypeError, match="returns a dictionary, not float"):
        as_json(1.5)  # type: ignore[arg-type]


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
