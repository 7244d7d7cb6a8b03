"""A run on the replica of Test Session 38 beside what Tweddle's thesis prints for the session itself.

    python -m lab.end_to_end.thesis [--record DIR]

The thesis (B. E. Tweddle, MIT, 2013) had images of a satellite on the space station, and compared with the
station's metrology, which errs by centimetres and degrees itself; its sigmas are those of its table 6.4. The
replica (configs/ts38.yaml) is simulated with its inertia, motion, camera and number of frames, but with an
exact calibration; errors are against its truth. runs/ts38 is made unless it is there.
"""

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from lab.command import RECORDS, ROOT, Record, command, evaluated_run
from lab.mapping import lengths
from lab.presentation import Row, print_table
from lab.record import Case, complete
from polhode.run_directory.trajectory_file import read_trajectory

RECORD = RECORDS / "thesis"
HEAD = "quantity | thesis | from its | polhode, simulated replica"
QUANTITIES = (
    ("position, against the reference [mm]", "9, 31, 14 (x, y, z)", "table 6.1, p. 217", "{position_mm:.3f}"),
    ("velocity [mm/s]", "1.3, 2.3, 1.6", "table 6.1, p. 217", "{velocity_mm_s:.3f}"),
    ("angular velocity [deg/s]", "1.5, 0.9, 0.9", "table 6.2, p. 218", "{angular_velocity_deg_s:.3f}"),
    ("attitude, for polhode after the constant rotation of the axes is removed [deg]", "13.5 (mean)",
     "table 6.2, p. 218", "{attitude_deg:.3f} (median)"),
    ("lengths on the model [mm]", "1.8 (mean of 8)", "table 6.3, p. 236",
     "{lengths_mm:.2f} (mean of {lengths})"),
    ("sigma of the position [mm]", "0.34, 0.29, 0.33", "table 6.4, p. 244",
     "{sigma_position_mm[0]:.3f}, {sigma_position_mm[1]:.3f}, {sigma_position_mm[2]:.3f}"),
    ("sigma of the centre of mass [mm]", "3.7, 4.3, 3.6", "table 6.4, p. 244",
     "{sigma_com_mm[0]:.3f}, {sigma_com_mm[1]:.3f}, {sigma_com_mm[2]:.3f}"),
    ("sigma of k1, k2", "0.0025, 0.0019", "table 6.4, p. 244", "{sigma_k[0]:.5f}, {sigma_k[1]:.5f}"),
    ("time for 115 stereo pairs", "35 min after 4.5 min of matching", "section 6.8, pp. 254-257",
     "{seconds:.0f} s, with the surface"),
)  # fmt: skip
"""Name, the thesis's figure, where it stands, the form of the run's by the names of ``measure``. Tables 6.1
and 6.2 give means and standard deviations of the differences; these are the latter."""


def main(
    run: Annotated[
        Path | None, arg(metavar="RUN", help="An evaluated run instead of that of the replica.")
    ] = None,
    sequence: Annotated[Path, arg(metavar="SEQ", help="Its sequence, of the same body.")] = ROOT
    / "data/ts38",
    record: Record = RECORD,
) -> None:
    """Run and evaluate unless the record has it, and print the table."""
    if run is not None:
        line = figures_of(run, sequence)
    else:
        (line,) = complete(record, [{"scene": "ts38"}], measure, 1)
    print_table(HEAD, table_rows(line))


def table_rows(line: Case) -> list[Row]:
    """``line`` has what ``measure`` returns."""
    return [[*words, form.format(**line)] for *words, form in QUANTITIES]


def measure(case: Case) -> dict[str, Any]:
    """The run's errors and standard deviations."""
    name = case["scene"]
    return figures_of(evaluated_run(ROOT / "configs" / f"{name}.yaml"), ROOT / "data" / name)


def figures_of(run: Path, sequence: Path) -> dict[str, Any]:
    """What the forms of ``QUANTITIES`` name, of an evaluated run."""
    metrics, summary = (json.loads((run / f"{name}.json").read_text()) for name in ("metrics", "summary"))
    found = lengths.measure(*lengths.in_true_frame(run, sequence))
    errors_mm = [abs(each.found_mm - each.true_mm) for each in found if each.found_mm is not None]
    return {
        "position_mm": 1e3 * metrics["rmse_position_m"],
        "velocity_mm_s": 1e3 * metrics["rmse_velocity_m_s"],
        "angular_velocity_deg_s": metrics["rmse_angular_velocity_deg_s"],
        "attitude_deg": metrics["attitude_error_deg"]["median"],
        "lengths_mm": float(np.mean(errors_mm)),
        "lengths": len(errors_mm),
        "sigma_position_mm": (1e3 * read_trajectory(run).sigma_r.mean(axis=0)).tolist(),
        "sigma_com_mm": (1e3 * np.sqrt(np.diag(summary["cov_com_G"]))).tolist(),
        "sigma_k": np.sqrt(np.diag(summary["inertia"]["cov"])).tolist(),
        "seconds": summary["timing_s"]["total"],
    }


if __name__ == "__main__":
    command(main)
