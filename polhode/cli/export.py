"""``polhode export``: a run in the formats of other programs."""

from dataclasses import fields
from pathlib import Path
from time import perf_counter
from typing import Annotated

from polhode.cli.answer import Answer, sizes_of
from polhode.cli.options import Command, Named, Positional
from polhode.planning.exports.formats import FORMATS


class ExportCommand(Command):
    """Write a run in the format of another program: its mesh, a body for simulators, or its motion.

    glb, ply, stl, obj: the mesh. urdf, mjcf, sdf: a free body with inertia, surface and convex pieces, whose
    meshes are written to a folder beside the file. aem, oem, tum: the predicted motion; tum also the
    estimated one. json: everything but the mesh, with covariances. What the run lacks is left out, with a
    warning.
    """

    run: Annotated[Path, Positional("RUN")]
    """Folder of a run."""
    to: Annotated[str, Named("|".join(FORMATS))]
    """Format of the file."""
    output: Annotated[Path, Named("FILE", "-o")]
    """The file. An earlier export is replaced, with its folder of meshes; any other file is not."""
    frame: Annotated[str | None, Named("G|P")] = None
    """Frame of the file: G of the run; P, principal axes at the centre of mass. The default is G, and P for
    aem, oem and tum."""
    unit: Annotated[str, Named("m|mm")] = "m"
    """Unit of glb, ply, stl and obj; the other formats have their own."""
    mass_kg: Annotated[float | None, Named("KG")] = None
    """Mass of the target [kg]; with the volume of the mesh and uniform density it sets the scale of the
    inertia. Without it the run's own where known forces determined it; otherwise the values are relative."""
    middle_moment_kg_m2: Annotated[float | None, Named("J")] = None
    """Middle principal moment [kg m^2], if known: it sets the scale of the inertia."""
    pieces: Annotated[int, Named("N")] = 512
    """Maximum number of convex pieces of the collision geometry; 1: the convex hull. Fewer pieces protrude
    more from the surface."""
    cover: Annotated[str, Named("auto|possible|outlines|surface|hull")] = "auto"
    """What the collision geometry contains. surface: the mesh; outlines: also what the outlines of several
    frames show; possible: also what no frame excludes; hull: the convex hull of what outlines show. auto:
    possible, or, in a run of an earlier version, surface."""
    poses: Annotated[str, Named("predicted|estimated")] = "predicted"
    """tum: the poses predicted from the last stereo pair on, or those that the run estimated at its pairs."""
    horizon_s: Annotated[float, Named("S", "--horizon")] = 60.0
    """Time to predict beyond the last stereo pair [s]."""
    step_s: Annotated[float | None, Named("S")] = None
    """Time between two rows [s]; the run's own interval unless given."""
    epoch: Annotated[str, Named("UTC")] = "1970-01-01T00:00:00"
    """UTC of timestamp 0 of the run."""
    object_name: Annotated[str, Named("NAME")] = "target"
    """Name of the target in the file."""
    object_id: Annotated[str, Named("ID")] = "UNKNOWN"
    """International designator of the target, for aem and oem."""

    def execute(self) -> Answer:
        """Check, export and print the path."""
        from polhode.planning.exports.export_run import export_run
        from polhode.planning.exports.options import ExportOptions
        from polhode.runtime.console import choose_progress

        values = {
            each.name: getattr(self, each.name) for each in fields(ExportOptions) if each.name != "horizon"
        }
        options, start = ExportOptions(**values, horizon=self.horizon_s), perf_counter()
        export = export_run(self.run, options, choose_progress())
        files, inertial = export.files, export.inertial
        meshes = f"Meshes: {len(files) - 1} files in {files[0].parent}" if len(files) > 1 else ""
        paths = tuple(reversed(files))
        figures = {
            "format": self.to,
            "files": sizes_of(paths),
            "mass_properties": inertial
            and {
                name: getattr(inertial, name)
                for name in ("mass_kg", "mass_is", "com_F", "moments_kg_m2", "scale_is")
            },
            "duration_s": perf_counter() - start,
        }
        return Answer(f"Export: {self.output}", meshes, paths=paths, figures=figures)
