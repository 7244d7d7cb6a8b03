"""Which settings serve ViSP's edge tracker best on rendered views: each one changed alone.

    python -m benchmarks.edges.visp_settings [BODY ...] [--views 40] [--seed 100]

Not the views of ``benchmarks.visp_tracker``, whose seed is another. ``failed``: lost, or off by more than
``FAR_M`` or ``FAR_DEG``. Medians are of all views. NEES: the median, 1 is honest (0.89 for a median).
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from tyro.conf import Positional

from benchmarks.command import command
from benchmarks.edges.views import middle, pose_errors
from benchmarks.edges.visp_tracker import (
    FAR_DEG,
    FAR_M,
    NoVispError,
    Options,
    Settings,
    Trial,
    nees,
    trial_of,
    visp_answer,
)
from polhode.errors import InputError
from polhode.lie import Array

BODIES = ("block", "ell", "tee", "satellite", "drum")
DEFAULT = Settings()
CHANGES: dict[str, Settings] = {
    "as it is": DEFAULT,
    **{f"threshold {value:g}": replace(DEFAULT, threshold=value) for value in (1000.0, 4000.0, 30000.0)},
    **{f"mu {value:g}": replace(DEFAULT, mu=value) for value in (0.2, 0.8)},
    **{f"mask of {value} px": replace(DEFAULT, mask_size=value) for value in (3, 7)},
    **{f"a site each {value:g} px": replace(DEFAULT, sample_step_px=value) for value in (1.0, 4.0)},
    **{
        f"ranges {value}": replace(DEFAULT, ranges_px=value)
        for value in ((8,), (8,) * 6, (20, 10, 5), (12, 8, 5, 3), (8, 6, 4, 3, 2))
    },
    **{f"{value} calls of track() a round": replace(DEFAULT, tracks=value) for value in (2, 4)},
    **{f"faces from {value:g} deg": replace(DEFAULT, appear_deg=value, disappear_deg=value + 1.0)
       for value in (70.0, 80.0)},
}  # fmt: skip


def row(label: str, settings: Settings, trials: Sequence[tuple[Trial, Array]]) -> str:
    """A line of the table, over all bodies."""
    errors, honesty, seconds = [], [], []
    for trial, X_CG in trials:
        answer = visp_answer(trial, settings)
        error = pose_errors(answer.X_CG, X_CG, middle(trial.mesh))
        honesty.append(nees(error[~answer.lost], answer.covariance[~answer.lost]) / 6)
        error[answer.lost] = np.inf
        errors.append(error)
        seconds.append(answer.statistics["seconds"])
    place_m, turn_rad = np.linalg.norm(np.vstack(errors).reshape(-1, 2, 3), axis=2).T
    failed = (place_m > FAR_M) | (turn_rad > np.deg2rad(FAR_DEG))
    return (
        f"| {label} | {failed.sum()} of {len(failed)} | {1e3 * np.median(place_m):.2f} | "
        f"{np.rad2deg(np.median(turn_rad)):.3f} | {np.median(np.concatenate(honesty)):.1f} | "
        f"{1e3 * np.median(np.concatenate(seconds)):.0f} |"
    )


def main(bodies: Positional[tuple[str, ...]] = BODIES, views: int = 40, seed: int = 100) -> None:
    """Print the table."""
    try:
        trials = [trial_of(name, Options(views=views, seed=seed)) for name in bodies]
        print("| settings | failed | median [mm] | median [deg] | NEES / 6 | ms per view |")
        print("|---|" + "---:|" * 5)
        for label, settings in CHANGES.items():
            print(row(label, settings, trials), flush=True)
    except (NoVispError, InputError) as problem:
        print(f"polhode: error: {problem}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    command(main)
