"""From edges, a camera and its places to the metric: the views, what each edge contributes, the files."""

import json
from pathlib import Path

import numpy as np

from polhode.atomic import write_bytes
from polhode.errors import InputError
from polhode.pipeline.products.observability import document, pictures
from polhode.pipeline.products.observability.assessment import Assessment
from polhode.pipeline.products.observability.choice import choose
from polhode.pipeline.products.observability.subject import Subject
from polhode.planning.edges.metric.contributions import contributions
from polhode.planning.edges.metric.information import FeatureInformation, by_feature, look_along
from polhode.planning.edges.metric.pictures import painted
from polhode.progress import Progress

MOST_MIB = 1024.0
"""Of matrices, one for each edge and view."""


def assess(
    subject: Subject, spacing_px: float, sigma_px: float, few: int | None, fewest: bool, progress: Progress
) -> Assessment:
    """Look from all places; choose the best ``few`` edges, or the fewest. InputError: memory lacks."""
    size_mib = len(subject.X_RG) * subject.model.size * 36 * 8 / 2**20
    if size_mib > MOST_MIB:
        raise InputError(
            f"{len(subject.X_RG)} poses of {subject.model.size} edges take {size_mib:.0f} MiB: "
            "give fewer poses, or a larger --crease-deg"
        )
    views, C = [], []
    with progress.stage("looking at edges", len(subject.X_RG)) as advance:
        for view in look_along(
            subject.model, subject.rig, subject.X_RG, subject.o_G, spacing_px, subject.sun_G
        ):
            views.append(view)
            C.append(by_feature(view.points, view.f, subject.model.size))
            advance()
    information = FeatureInformation(np.stack(C), subject.model.radius_m)
    with progress.stage("choosing edges", 1) as advance:
        choice = choose(information, few, fewest)
        advance()
    return Assessment(subject, views, contributions(information), choice, spacing_px, sigma_px)


def write(found: Assessment, folder: Path) -> list[str]:
    """All files into the folder, whole or not at all; their names."""
    model, shares = found.subject.model, found.edges.share
    files: dict[str, bytes] = {
        "observability.csv": document.table(found).encode(),
        "edges.csv": document.edge_table(found).encode(),
    }
    best = max(range(len(found.views)), key=lambda k: len(found.views[k].points))
    files["metric.png"] = pictures.draw_metric(found)
    if len(found.views[best].points):
        files["views.png"] = pictures.draw_views(found)
        files["contributions.png"] = pictures.draw_contributions(found, best)
        overall = np.nan_to_num(shares).max(axis=1)
        coloured, legend = painted(model, overall)
        for suffix in "ply", "glb":
            content = coloured.export(file_type=suffix)
            assert isinstance(content, bytes)
            files[f"edges.{suffix}"] = content
    else:
        legend = None
    files["observability.json"] = (
        json.dumps(document.document(found, legend), indent=1, allow_nan=False) + "\n"
    ).encode()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            write_bytes(folder / name, content)
        for name in set(NAMES) - set(files):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); choose another -o") from error
    return list(files)


NAMES = (
    "observability.json",
    "observability.csv",
    "edges.csv",
    "metric.png",
    "views.png",
    "contributions.png",
    "edges.ply",
    "edges.glb",
)
"""What the command writes; of an earlier call, what this one has not is removed."""
