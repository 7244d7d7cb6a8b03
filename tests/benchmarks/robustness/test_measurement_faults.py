"""A row of the campaign on measurements: what the record and the verdict's benchmark read of it."""

from benchmarks.robustness.measurement_faults import measure
from benchmarks.robustness.verdict import judged_runs


def test_an_undisturbed_body_is_right_and_not_doubted() -> None:
    case = {"scene": 2, "fault": "none"}
    row = measure(case)
    assert row["status"] == "ok" and not row["wrong"]
    runs = judged_runs([row | {"case": case}])
    assert runs.good.all() and runs.undisturbed.all() and not runs.said.any()
    # checks of the answer and of the data are both made
    names = set(row["checks"])
    assert {
        "difference between the solutions of two random halves of the landmarks",
        "period of rotation from the images over that from the timestamps: deviation from 1",
    } <= names
