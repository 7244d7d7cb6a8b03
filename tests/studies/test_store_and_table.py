"""Records on disk, and the table that is made of them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.runtime.errors import InputError
from polhode.studies import store as store_module
from polhode.studies.steps import failed_record, flattened
from polhode.studies.store import Store
from polhode.studies.table import load_study, row_of, schema_of


def address(number: int) -> str:
    return f"{number:064x}"


ADDRESS = address(1)


def record(**other: Any) -> dict[str, Any]:
    return failed_record(ADDRESS, {"seed": 1}, "run: no motion") | other


def test_records_are_read_back_packed_or_not_and_a_damaged_one_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, damaged = Store(tmp_path / "damaged"), Store(tmp_path / "damaged").record_file(ADDRESS)
    assert store.read(ADDRESS) is None
    store.write(record())
    assert store.read(ADDRESS) == record(times=store.read(ADDRESS)["times"])  # type: ignore[index]
    text = damaged.read_text()
    for wrong in (text[:100], text.replace("failed", "done")):
        damaged.write_text(wrong)
        assert store.read(ADDRESS) is None
    store.record_file(address(2)).write_text(text)
    assert store.read(address(2)) is None

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
    store.write(record(address=ADDRESS, verdict="ok"))
    assert [each["verdict"] for each in store.records()][:4] == ["v7", "v3", "v0", "ok"]
    store.pack(without={address(0)})
    assert len(list(Store(tmp_path).records())) == 10
    assert Store(tmp_path).read(address(0)) is None and Store(tmp_path).read(ADDRESS)["verdict"] == "ok"  # type: ignore[index]
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


def test_results_become_flat_finite_columns_of_their_types_after_the_settings(tmp_path: Path) -> None:
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
