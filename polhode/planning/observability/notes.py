"""What deserves a warning beside the numbers: doubts about mesh, unit, trajectory; impossible selections."""

from collections import Counter

import numpy as np

from polhode.planning.edges.orientation import winding_number
from polhode.planning.observability.assess import Assessment, Choice

SMALL_PX = 10.0
"""A body that is smaller in the image hardly shows an edge."""
MAX_DESCRIPTIONS = 3


def notes_of(assessment: Assessment) -> tuple[str, ...]:
    """A sentence for each doubt."""
    return (*assessment.subject.notes, *_about_the_poses(assessment))


def _about_the_poses(assessment: Assessment) -> list[str]:
    subject, views = assessment.subject, assessment.views
    model, notes = subject.model, []
    eyes_G = [-view.X_RG[:3, :3].T @ view.X_RG[:3, 3] for view in views]
    inside = sum(model.encloses(eye) for eye in eyes_G)
    if inside:
        unit = ": are its unit and the trajectory right?" if inside == len(views) else ""
        notes.append(f"the camera is inside the body at {_poses(inside, len(views))}{unit}")
    lowest, highest = model.surface.bounds
    if not model.closed.all():
        triangles = np.asarray(model.surface.triangles)
        within = [bool((eye >= lowest).all() and (eye <= highest).all()) for eye in eyes_G]
        enclosed = sum(
            near and not model.encloses(eye) and winding_number(triangles, eye) > 0.5
            for eye, near in zip(eyes_G, within, strict=True)
        )
        if enclosed:
            notes.append(
                f"the camera is behind faces of the open surface that enclose it for the most part at "
                f"{_poses(enclosed, len(views))}: if that is inside the body, these results do not hold"
            )
    width_px = max(2.0 * model.radius_m * subject.rig.focal_px / max(view.range_m, 1e-300) for view in views)
    if width_px < SMALL_PX:
        notes.append(
            f"the body is at most {width_px:.2g} px across in the image: are its unit and the trajectory "
            "right?"
        )
    return notes


def _poses(count: int, of: int) -> str:
    return "every pose" if count == of else f"{count} of {of} poses"


def unobservable_lines(assessment: Assessment) -> list[str]:
    """Descriptions of what is unobservable, the most frequent ones first, with the numbers of poses."""
    count = len(assessment.views)
    found = Counter(view.describe_unobservable() for view in assessment.views)
    found.pop("", None)
    lines = [f"  at {_poses(times, count)}: {text}" for text, times in found.most_common(MAX_DESCRIPTIONS)]
    more = len(found) - len(lines)
    return (
        [*lines, f"  and {more} further description{'' if more == 1 else 's'}, in observability.csv"]
        if more
        else lines
    )


def selection_lines(choice: Choice) -> list[str]:
    """Lines about the selected sets of edges."""
    if choice.impossible:
        return [
            "No set of edges can be selected: not even all edges determine a degree of freedom at any pose"
        ]
    lines = []
    if choice.smallest is not None:
        count, least = len(choice.smallest.features), choice.smallest.at_least
        lines.append(
            f"{_edges(count)} suffice{'s' if count == 1 else ''}: every sigma within 10 % of that with all "
            f"({'no fewer suffice' if count == least else f'at least {least} are required'})"
        )
    if choice.best is not None and choice.best_ratio is not None:
        worst, count = float(np.nanmax(choice.best_ratio)), len(choice.best.features)
        effect = (
            f"sigmas up to {worst:.2f} times those with all"
            if np.isfinite(worst)
            else f"{'it leaves' if count == 1 else 'they leave'} the pose partly undetermined"
        )
        best = "The best edge" if count == 1 else f"The best {count} edges"
        lines.append(f"{best}: {effect}; marked in edges.csv")
        if choice.wanted is not None and choice.wanted > count:
            lines.append(f"{_edges(count)} instead of {choice.wanted}: no other is seen from these poses")
    return lines


def _edges(count: int) -> str:
    return f"{count} edge{'' if count == 1 else 's'}"
