"""The files of an assessment: tables of the views and of the edges, everything as JSON, and figures."""

import csv
import io
import json
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.output.marked_folder import marked_folder, write_files
from polhode.geometry.lie import Array
from polhode.planning.edges.edge_model import EdgeKind
from polhode.planning.edges.expected_tracking import SUN_ANGLE_DEG
from polhode.planning.edges.observability_metric import DEGREES_OF_FREEDOM
from polhode.planning.observability import pictures
from polhode.planning.observability.assess import Assessment, Choice
from polhode.planning.observability.notes import (
    notes_of,
    selection_lines,
    unobservable_lines,
)
from polhode.planning.observability.pictures import Legend, coloured_body

SCHEMA = "polhode-observability/1"
FILES = (
    "observability.json",
    "observability.csv",
    "edges.csv",
    "metric.png",
    "views.png",
    "contributions.png",
    "edges.ply",
    "edges.glb",
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
    model, shares = assessment.subject.model, assessment.edges.share
    files: dict[str, bytes] = {
        "observability.csv": table(assessment).encode(),
        "edges.csv": edge_table(assessment).encode(),
    }
    best = max(range(len(assessment.views)), key=lambda k: len(assessment.views[k].points))
    files["metric.png"] = pictures.draw_metric(assessment)
    if len(assessment.views[best].points):
        files["views.png"] = pictures.draw_views(assessment)
        files["contributions.png"] = pictures.draw_contributions(assessment, best)
        overall = np.nan_to_num(shares).max(axis=1)
        coloured, legend = coloured_body(model, overall)
        for suffix in "ply", "glb":
            content = coloured.export(file_type=suffix)
            assert isinstance(content, bytes)
            files[f"edges.{suffix}"] = content
    else:
        legend = None
    files["observability.json"] = (
        json.dumps(document(assessment, legend), indent=1, allow_nan=False) + "\n"
    ).encode()
    write_files(folder, COMMAND, files, FILES.__contains__)
    return list(files)


def pose_rows(assessment: Assessment) -> list[dict[str, Any]]:
    """Numbers of each view: the columns of observability.csv and, with matrices, the poses of the JSON file.

    sigma (6,) and expected_sigma (6,) are inf where the visible edges do not determine them.
    """
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
        for time, sigma, expected, view in zip(
            assessment.subject.time_s,
            assessment.sigma,
            assessment.expected_sigma,
            assessment.views,
            strict=True,
        )
    ]


def table(assessment: Assessment) -> str:
    """observability.csv: one row per pose."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    for number, row in enumerate(pose_rows(assessment)):
        cells = {"time_s": f"{row['time_s']:.9f}"}
        for name, value in row.items():
            if isinstance(value, np.ndarray):
                cells |= {f"{name}_{each}": f"{part:.6g}" for each, part in zip(NAMES, value, strict=True)}
            elif name not in cells:
                cells[name] = f"{value:.6g}" if isinstance(value, float) else str(value)
        if number == 0:
            out.writerow(cells)
        out.writerow(cells.values())
    return text.getvalue()


def edge_table(assessment: Assessment) -> str:
    """edges.csv: one row per feature of the model; shares and rises of the variances along the trajectory."""
    model, edges = assessment.subject.model, assessment.edges
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    ends = [f"{end}_{axis}_m" for end in ("a", "b") for axis in "xyz"]
    dofs = [name.removesuffix("_m").removesuffix("_rad") for name in NAMES]
    out.writerow(
        [
            *("edge", "kind", "length_m", *ends),
            *(f"share_{d}" for d in dofs),
            *(f"rise_{d}" for d in dofs),
            *("in_smallest_set", "in_best"),
        ]
    )
    smallest, best = assessment.choice.smallest, assessment.choice.best
    sets = [set() if each is None else set(each.features.tolist()) for each in (smallest, best)]
    lengths_m = model.lengths_m
    kinds = [EdgeKind(kind).name.lower() for kind in model.kind] + ["outline"] * len(model.outlined)
    for k, kind in enumerate(kinds):
        if k >= len(model.ends_G) and not model.outlined[k - len(model.ends_G)]:
            continue
        segment: list[str] = [""] * 7
        if k < len(model.ends_G):
            segment = [
                f"{lengths_m[k]:.6g}",
                *(f"{value:.6g}" for value in model.ends_G[k].reshape(-1)),
            ]
        shares = (f"{value:.6g}" for value in (*edges.share[k], *edges.rise[k]))
        out.writerow([k, kind, *segment, *shares, *(int(k in each) for each in sets)])
    return text.getvalue()


def document(assessment: Assessment, legend: Legend | None) -> dict[str, Any]:
    """observability.json. Infinite or unknown values are null, with a description of the reason."""
    subject, model = assessment.subject, assessment.subject.model
    rig = subject.rig
    return {
        "schema": SCHEMA,
        "source": subject.source,
        "camera": {
            name: getattr(rig, name) for name in ("focal_px", "cx_px", "cy_px", "width_px", "height_px")
        },
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
        "spacing_px": assessment.spacing_px,
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
        "along": along(assessment),
        "edges": {
            "file": "edges.csv",
            "painted": None
            if legend is None
            else {
                "words": "largest share of a degree of freedom's variance",
                "values": legend.values.tolist(),
                "rgb": legend.rgb.tolist(),
            },
        },
        "choice": choice_of(assessment.choice),
        "notes": list(notes_of(assessment)),
    }


def choice_of(choice: Choice) -> dict[str, Any]:
    """Sets of edges: numbers as in edges.csv; ratios of sigma to that of all edges."""
    smallest, best = choice.smallest, choice.best
    return {
        "views": choice.views,
        "smallest_set": None
        if smallest is None
        else {
            "words": "each sigma at most 10 % above that of all edges, root mean square over the views",
            "edges": smallest.features.tolist(),
            "ratio": _numbers(smallest.ratio),
            "at_least": smallest.at_least,
        },
        "best": None
        if best is None or choice.best_ratio is None
        else {
            "words": "6 minus the mean trace of C^-1 (lengths in radii, with a prior of 1), greedy; no set "
            "of this size has a value above the bound",
            "edges": best.features.tolist(),
            "ratio": _numbers(choice.best_ratio),
            "value": best.value,
            "bound": choice.bound,
        },
    }


def along(assessment: Assessment) -> dict[str, Any]:
    """Summary of the trajectory: over the views that determine a degree of freedom, and how many do not."""
    sigma = assessment.sigma
    determined = np.isfinite(sigma)
    values = {
        name: {
            "median": _numbers(np.median(sigma[determined[:, k], k]) if determined[:, k].any() else np.inf),
            "best": _numbers(sigma[:, k].min()),
            "worst": _numbers(sigma[:, k].max()),
            "poses_that_do_not_tell": int((~determined[:, k]).sum()),
        }
        for k, name in enumerate(NAMES)
    }
    return {"sigma": values, "poses": len(sigma), "poses_that_tell_all": int(determined.all(axis=1).sum())}


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
        f"for {assessment.sigma_px:g} px of noise normal to the edges every {assessment.spacing_px:g} px, "
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
    lines += unobservable_lines(assessment)
    lines += selection_lines(assessment.choice)
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
