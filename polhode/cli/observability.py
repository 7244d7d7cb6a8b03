"""``polhode observability``: how well edges determine the pose along a camera trajectory."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from polhode.cli.answer import Answer
from polhode.cli.options import Command, Named, Positional

ImageSide = Annotated[int | None, Named("PX"), Field(ge=16, le=100_000)]
Coordinate = Annotated[float, Field(ge=-1e12, le=1e12)]
"""[m]"""


class ObservabilityCommand(Command):
    """How well edge tracking could determine the pose along a trajectory, before any image exists.

    C = sum of f f^T over the visible edges, f their motion perpendicular to themselves under each degree of
    freedom; C^-1 is the covariance of the pose for noise of one pixel (docs/observability.md). Writes
    observability.json and .csv, edges.csv, metric.png, contributions.png.
    """

    source: Annotated[Path, Positional("RUN|MESH")]
    """Folder of a run, whose mesh is used, or a mesh file (PLY, STL, OBJ, GLB)."""
    output: Annotated[Path, Named("DIR", "-o")]
    """Folder of the results: a new or empty one, or that of an earlier call, whose files are replaced."""
    trajectory: Annotated[Path | None, Named("FILE")] = None
    """Camera trajectory, TUM format: one line per pose, timestamp tx ty tz qx qy qz qw; the camera looks
    along its z axis, x points right, y down. A run's own unless given."""
    frame: Annotated[Literal["body", "inertial", "G", "N"] | None, Named("body|inertial")] = None
    """Frame in which the trajectory states the camera's poses. body (or G, the frame of the mesh): fixed to
    the target. inertial (or N, the inertial frame of the run): the target tumbles on as predicted, and times
    are seconds after the last pair of the run. body unless given, and inertial for the file that
    `polhode plan` writes, whose first line says so."""
    sun: Annotated[tuple[float, float, float] | None, Named("X Y Z")] = None
    """Direction to the Sun, of any length, for what is expected of a tracker. In N for a run, in its own
    frame for a mesh. Without it, some around the camera."""
    about: Annotated[tuple[Coordinate, Coordinate, Coordinate] | None, Named("X Y Z")] = None
    """Reference point in G [m] of translations and rotations. The centre of mass of a run, or the centre of
    the mesh's bounding box, unless given."""
    sigma_px: Annotated[float, Named("PX")] = 1.0
    """Standard deviation of the distance to an edge, at each sample point: one every 10 px."""
    crease_deg: Annotated[float, Named("DEG"), Field(gt=0, lt=180)] = 30.0
    """For a mesh: faces that meet at a larger angle form an edge."""
    unit: Literal["m", "mm"] = "m"
    """Unit of a mesh file."""
    focal_px: Annotated[float | None, Named("PX"), Field(ge=1.0, le=1e9)] = None
    """Focal length; a run's own, or 800, unless given."""
    width_px: ImageSide = None
    """Width of the image; a run's own, or 640."""
    height_px: ImageSide = None
    """Height of the image; a run's own, or 480."""
    edges: Annotated[int | None, Named("N")] = None
    """Also select the best N edges: those that minimize the variance over the trajectory."""

    def execute(self) -> Answer:
        """Check, assess, write and print."""
        import numpy as np

        from polhode.planning.observability.assess import (
            CameraOptions,
            assess,
            check_numbers,
            subject_of,
            sun_direction,
        )
        from polhode.planning.observability.files import (
            NAMES,
            assessment_folder,
            format_assessment,
            write_assessment,
        )
        from polhode.planning.plan_files import is_in_N
        from polhode.runtime.console import choose_progress

        with assessment_folder(self.output) as place:
            check_numbers(self.sigma_px, self.edges)
            sun = sun_direction(self.sun)
            stated = "N" if self.trajectory is not None and is_in_N(self.trajectory) else "G"
            subject = subject_of(
                self.source,
                self.trajectory,
                {"body": "G", "inertial": "N"}.get(self.frame or stated, self.frame or stated),
                CameraOptions(self.focal_px, self.width_px, self.height_px),
                None if self.about is None else np.array(self.about),
                sun,
                self.crease_deg,
                1.0 if self.unit == "m" else 1e-3,
            )
            assessment = assess(subject, self.sigma_px, self.edges, choose_progress())
            names = write_assessment(assessment, place)
        return Answer(
            f"{', '.join(names)}: {self.output}",
            format_assessment(assessment),
            paths=(self.output, *(self.output / name for name in names)),
            figures={
                "poses": len(assessment.views),
                "edges": assessment.subject.model.size,
                "sigma_px": assessment.sigma_px,
                "median_sigma": dict(zip(NAMES, np.median(assessment.sigma, axis=0), strict=True)),
            },
        )
