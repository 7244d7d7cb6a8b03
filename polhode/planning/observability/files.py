"""The files of an assessment: tables of the views and of the edges, all of it as JSON; the screen's text."""

import csv
import io
import json
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.output.marked_folder import marked_folder, write_files
from polhode.geometry.lie import Array
from polhode.planning.edges.edge_model import EdgeKind
from polhode.planning.edges.expected_tracking import SUN_ANGLE_DEG
from polhode.planning.edges.observability_metric import DEGREES_OF_FREEDOM
from polhode.planning.edges.visible_edges import SPACING_PX
from polhode.planning.observability import pictures
from polhode.planning.observability.assess import Assessment, Choice

SCHEMA = "polhode-observability/1"
FILES = (
    "observability.json",
    "observability.csv",
    "edges.csv",
    "metric.png",
    "contributions.png",
)
"""Files that the command writes; those of an earlier call that this one does not write are removed."""
COMMAND = "observability"
NAMES = ("x_m", "y_m", "z_m", "about_x_rad", "about_y_rad", "about_z_rad")


def assessment_folder(path: Path) -> AbstractContextManager[Path]:
    """The folder of the results, links followed; checked before the work, and locked until it is written.

    Raises InputError.
    """
    return marked_folder(path, COMMAND, FILES.__contains__)


def write_assessment(assessment: Assessment, folder: Path) -> list[str]:
    """Write all files or none; returns their names. Raises InputError, RunFailure."""
    files = {
        "observability.csv": table(assessment).encode(),
        "edges.csv": edge_table(assessment).encode(),
        "metric.png": pictures.draw_metric(assessment),
    }
    best = max(range(len(assessment.views)), key=lambda k: len(assessment.views[k].points))
    if len(assessment.views[best].points):
        files["contributions.png"] = pictures.draw_contributions(assessment, best)
    text = json.dumps(document(assessment), indent=1, allow_nan=False) + "\n"
    files["observability.json"] = text.encode()
    write_files(folder, COMMAND, files, FILES.__contains__)
    return list(files)


def pose_rows(assessment: Assessment) -> list[dict[str, Any]]:
    """Numbers of each view: the columns of observability.csv and, with matrices, the poses of the JSON file.

    sigma (6,) and expected_sigma (6,) are inf where the visible edges do not determine them.
    """
    along = assessment.subject.time_s, assessment.sigma, assessment.expected_sigma, assessment.views
    return [
        {
            "time_s": float(time),
            "range_m": view.range_m,
            "edges_expected": view.expected_edges,
            "points": len(view.points),
            "edge_length_px": view.length_px,
            "sigma": sigma,
            "expected_sigma": expected,
            "position_dop_m_per_px": view.metric.position_dop,
            "attitude_dop_rad_per_px": view.metric.attitude_dop,
            "geometric_dop_per_px": view.metric.geometric_dop,
            "condition": view.metric.condition,
            "not_told": view.describe_unobservable(),
        }
        for time, sigma, expected, view in zip(*along, strict=True)
    ]


def table(assessment: Assessment) -> str:
    """observability.csv: one row per pose."""
    rows = []
    for row in pose_rows(assessment):
        cells = {"time_s": f"{row.pop('time_s'):.9f}"}
        for name, value in row.items():
            if isinstance(value, np.ndarray):
                cells |= {f"{name}_{each}": f"{part:.6g}" for each, part in zip(NAMES, value, strict=True)}
            else:
                cells[name] = f"{value:.6g}" if isinstance(value, float) else str(value)
        rows.append(cells)
    return _csv([list(rows[0]), *(list(each.values()) for each in rows)])


def edge_table(assessment: Assessment) -> str:
    """edges.csv: one row per feature of the model; shares and rises of the variances along the trajectory."""
    model, edges, choice = assessment.subject.model, assessment.edges, assessment.choice
    best = set() if choice is None else set(choice.edges.tolist())
    segments = len(model.ends_G)
    kinds = [EdgeKind(kind).name.lower() for kind in model.kind] + ["outline"] * len(model.outlined)
    segment = np.column_stack([model.lengths_m, model.ends_G.reshape(-1, 6)])
    rows: list[list[object]] = [
        [
            *("edge", "kind", "length_m", *(f"{end}_{axis}_m" for end in "ab" for axis in "xyz")),
            *(f"{what}_{name.rsplit('_', 1)[0]}" for what in ("share", "rise") for name in NAMES),
            "in_best",
        ]
    ]
    for k, kind in enumerate(kinds):
        if k < segments or model.outlined[k - segments]:
            place = [f"{value:.6g}" for value in segment[k]] if k < segments else [""] * 7
            shares = (f"{value:.6g}" for value in (*edges.share[k], *edges.rise[k]))
            rows.append([k, kind, *place, *shares, int(k in best)])
    return _csv(rows)


def _csv(rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def document(assessment: Assessment) -> dict[str, Any]:
    """observability.json. Infinite or unknown values are null, with a description of the reason."""
    subject, model, choice = assessment.subject, assessment.subject.model, assessment.choice
    camera = ("focal_px", "cx_px", "cy_px", "width_px", "height_px")
    # over the views that determine a degree of freedom, and how many do not
    sigma = assessment.sigma
    determined = np.isfinite(sigma)
    return {
        "schema": SCHEMA,
        "source": subject.source,
        "camera": {name: getattr(subject.rig, name) for name in camera},
        "model": {
            "segments": len(model.ends_G),
            "smooth_parts": int(model.outlined.sum()),
            "length_m": float(model.lengths_m.sum()),
            "faces": len(model.surface.faces),
            "tolerance_m": model.tolerance_m,
            "radius_m": model.radius_m,
        },
        "about": {"words": subject.about, "o_G": subject.o_G.tolist()},
        "degrees_of_freedom": {
            "names": list(DEGREES_OF_FREEDOM),
            "words": "translations of o along the camera's axes (right, down, forward) [m], rotations about "
            "them through o [rad]; C, in pixels squared per unit, is the information of the edges for one "
            "pixel of noise; sigma is the root of the diagonal of sigma_px^2 C^-1; expected_sigma is that of "
            "a tracker, with light, shadows and edges side by side considered",
        },
        "sigma_px": assessment.sigma_px,
        "spacing_px": SPACING_PX,
        "sunlit": subject.sun_G is not None,
        "poses": [
            {
                **{name: _numbers(value) for name, value in row.items()},
                "X_RG": view.X_RG.tolist(),
                "C": view.metric.C.tolist(),
                "covariance": _numbers(assessment.sigma_px**2 * view.metric.covariance),
            }
            for row, view in zip(pose_rows(assessment), assessment.views, strict=True)
        ],
        "along": {
            "sigma": {
                name: {
                    "median": _numbers(np.median(own[known]) if known.any() else np.inf),
                    "best": _numbers(own.min()),
                    "worst": _numbers(own.max()),
                    "poses_that_do_not_tell": int((~known).sum()),
                }
                for name, own, known in zip(NAMES, sigma.T, determined.T, strict=True)
            },
            "poses": len(sigma),
            "poses_that_tell_all": int(determined.all(axis=1).sum()),
        },
        # numbers as in edges.csv; ratios of sigma to that of all edges
        "best": choice and {"edges": choice.edges.tolist(), "ratio": _numbers(choice.ratio)},
        "notes": list(notes_of(assessment)),
    }


def _numbers(value: Any) -> Any:
    """Arrays as lists; null where a number is infinite or unknown."""
    if isinstance(value, np.ndarray):
        return [_numbers(each) for each in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def format_assessment(assessment: Assessment) -> str:
    """Summary for the screen."""
    model, lines = assessment.subject.model, []
    smooth = int(model.outlined.sum())
    lines.append(
        f"Edge model: {len(model.ends_G)} straight edges, {model.lengths_m.sum():.2f} m in total, "
        f"and the outlines of {smooth} smooth part{'' if smooth == 1 else 's'}"
    )
    lines.append(
        f"Metric of {len(assessment.views)} pose{'' if len(assessment.views) == 1 else 's'}, "
        f"for {assessment.sigma_px:g} px of noise normal to the edges every {SPACING_PX:g} px, "
        f"about {assessment.subject.about}:"
    )
    lines += _of_each_freedom(assessment.sigma)
    lit = assessment.subject.sun_G is not None
    light = (
        "in this sunlight"
        if lit
        else f"with the Sun {SUN_ANGLE_DEG:.0f} degrees from the camera, on all sides"
    )
    lines.append(f"Expected of a tracker {light}; shadows and edges side by side are considered:")
    lines += _of_each_freedom(assessment.expected_sigma)
    lines += _unobservable_lines(assessment)
    lines += _selection_lines(assessment.choice)
    return "\n".join([*lines, *(f"Note: {note}" for note in notes_of(assessment))])


def _of_each_freedom(sigma: Array) -> list[str]:
    """Median and range of standard deviations (k, 6) [m, rad] over the poses, a line for each."""
    lines, determined = [], np.isfinite(sigma)
    units = (("mm", 1e3),) * 3 + (("deg", np.degrees(1.0)),) * 3
    for k, (name, (unit, scale)) in enumerate(zip(DEGREES_OF_FREEDOM, units, strict=True)):
        own = scale * sigma[determined[:, k], k]
        lost = len(sigma) - len(own)
        note = f"undetermined at {lost} of {len(sigma)} poses" if lost else ""
        if len(own):
            numbers = f"{np.median(own):9.4g} {unit:3s} ({own.min():.4g} to {own.max():.4g})"
            lines.append(f"  {name:8s} {numbers}{'; ' + note if note else ''}")
        else:
            lines.append(f"  {name:8s} {'inf':>9s} {unit:3s}; undetermined at every pose")
    return lines


def _unobservable_lines(assessment: Assessment) -> list[str]:
    """Descriptions of what is unobservable, the most frequent ones first, with the numbers of poses."""
    count = len(assessment.views)
    found = Counter(view.describe_unobservable() for view in assessment.views)
    found.pop("", None)
    lines = [f"  at {_poses(times, count)}: {text}" for text, times in found.most_common(3)]
    more = len(found) - len(lines)
    further = f"  and {more} further description{'' if more == 1 else 's'}, in observability.csv"
    return [*lines, further] if more else lines


def _selection_lines(choice: Choice | None) -> list[str]:
    if choice is None:
        return []
    count, worst = len(choice.edges), float(np.nanmax(choice.ratio, initial=0.0))
    if count == 0 or np.isnan(choice.ratio).all():
        return [
            "No set of edges can be selected: not even all edges determine a degree of freedom at any pose"
        ]
    effect = (
        f"sigmas up to {worst:.2f} times those with all"
        if np.isfinite(worst)
        else f"{'it leaves' if count == 1 else 'they leave'} the pose partly undetermined"
    )
    best, few = "The best edge" if count == 1 else f"The best {count} edges", choice.wanted > count
    more = f"; no other is seen, so these are fewer than {choice.wanted}" if few else ""
    return [f"{best}: {effect}; marked in edges.csv{more}"]


def notes_of(assessment: Assessment) -> tuple[str, ...]:
    """A sentence for each doubt about mesh, unit and trajectory."""
    subject, views = assessment.subject, assessment.views
    model, notes, question = subject.model, list(subject.notes), "are its unit and the trajectory right?"
    inside = sum(model.encloses(-view.X_RG[:3, :3].T @ view.X_RG[:3, 3]) for view in views)
    if inside:
        doubt = f": {question}" if inside == len(views) else ""
        notes.append(f"the camera is inside the body at {_poses(inside, len(views))}{doubt}")
    width_px = max(2.0 * model.radius_m * subject.rig.focal_px / max(view.range_m, 1e-300) for view in views)
    # a smaller body hardly shows an edge
    if width_px < 10.0:
        notes.append(f"the body is at most {width_px:.2g} px across in the image: {question}")
    return tuple(notes)


def _poses(count: int, of: int) -> str:
    return "every pose" if count == of else f"{count} of {of} poses"
