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


def address(number: int) -> str:
    return f"{number:064x}"


ADDRESS = address(1)


def record(**other: Any) -> dict[str, Any]:
    return failed_record(ADDRESS, {"seed": 1}, "run: no motion") | other


def test_a_record_is_read_back_and_a_damaged_one_is_none(tmp_path: Path) -> None:
    store, written = Store(tmp_path), record()
    assert store.read(ADDRESS) is None
    store.write(written)
    assert store.read(ADDRESS) == written
    file, moved = store.record_file(ADDRESS), store.record_file(address(2))
    text = file.read_text()
    assert text.count("failed") == 1
    for damaged in (text[:100], text.replace("failed", "done")):
        file.write_text(damaged)
        assert store.read(ADDRESS) is None
    moved.write_text(text)
    assert store.read(address(2)) is None


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
    # one that is computed again replaces the packed one
    store.write(record(address=address(1), verdict="ok"))
    assert [each["verdict"] for each in store.records()][:4] == ["v7", "v3", "v0", "ok"]
    store.pack(without={address(0)})
    assert len(list(Store(tmp_path).records())) == 10
    assert Store(tmp_path).read(address(0)) is None and Store(tmp_path).read(address(1))["verdict"] == "ok"  # type: ignore[index]
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


def test_metrics_are_flat_and_finite_and_what_was_measured_is_json() -> None:
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
        **{f"run.com.{k}": k + 1.0 for k in range(3)},
        "run.name": "ipopt",
        "run.holds": True,
    }
    found = as_json({"a": np.arange(2.0), "b": (np.float64(np.nan), True), "c": {"d": None, "e": "x"}})
    assert found == {"a": [0.0, 1.0], "b": [None, True], "c": {"d": None, "e": "x"}}
    json.dumps(found, allow_nan=False)
    with pytest.raises(TypeError, match="no number, text or list of them: object"):
        as_json({"a": [object()]})
    with pytest.raises(TypeError, match="returns a dictionary, not float"):
        as_json(1.5)  # type: ignore[arg-type]


def test_columns_have_the_type_of_their_values_and_results_follow_the_settings(tmp_path: Path) -> None:
    rows = [
        row_of(0, record(metrics={"evaluate.e": 1, "run.k": 1.0, "run.ok": None})),
        row_of(1, record(metrics={"evaluate.e": 2.5, "run.n": 3, "run.ok": True})),
    ]
    schema = schema_of(rows)
    kinds = {field.name: str(field.type) for field in schema}
    names = ("evaluate.e", "run.k", "run.n", "run.ok", "verdict", "reason")
    assert [kinds[name] for name in names] == ["double", "double", "int64", "bool", "string", "string"]
    assert schema.names[:3] == ["point", "seed", "status"] and schema.names[-1] == "digest.point"
    places = [schema.names.index(name) for name in ("run.n", "evaluate.e", "time.finished")]
    assert places == sorted(places)
    with pytest.raises(InputError, match="no study of polhode sweep"):
        load_study(tmp_path)
