"""The frame of the exported file: G, P, or that of a CAD model, to which the run is aligned."""

from pathlib import Path

import numpy as np

from polhode.files.tables import number_rows
from polhode.geometry.lie import inverse_pose, make_pose
from polhode.mapping.mesh_files import read_mesh
from polhode.planning.exports.cad_alignment import CadAlignment, align_points, align_surfaces
from polhode.planning.exports.options import METRES, ExportOptions
from polhode.planning.exports.records import Placement
from polhode.records.surface import SurfaceModel
from polhode.run_directory.summary_schema import Summary
from polhode.runtime.errors import InputError

POOR_SHARE = 0.02
"""Share of the body's size: a larger residual of the alignment gives a warning."""
POINT_COLUMNS = "x, y, z in G [m] and x, y, z in the CAD frame [--cad-unit]"
MAX_POINTS = 100_000
MAX_COORDINATE = 1e9
SIZES = (0.25, 4.0)
"""Size of the model over that of the mesh: outside this range the unit is wrong."""


def placement(
    options: ExportOptions, summary: Summary, surface: SurfaceModel | None
) -> tuple[Placement, list[str]]:
    """The frame, and warnings. Raises InputError, one line."""
    name = options.frame_name
    if name == "cad":
        return _cad_frame(options, surface)
    if options.cad is not None or options.cad_points is not None:
        option = "--cad" if options.cad is not None else "--cad-points"
        raise InputError(f"{option} is for --frame cad, and this is --frame {name}")
    if name == "G":
        return Placement("G", np.eye(4), "G, the geometric frame of the run, fixed to the target"), []
    if summary.R_GP is None or summary.com_G is None:
        raise InputError(
            "--frame P: this run has no estimate, so no principal axes; --frame G has no need of it"
        )
    warnings = []
    if summary.identifiable is not None and not (summary.identifiable.axes and summary.identifiable.com):
        warnings.append(
            "the run does not determine every principal axis or every component of the centre of mass: "
            "frame P is the best finite one"
        )
    X_PG = inverse_pose(make_pose(np.array(summary.R_GP), np.array(summary.com_G)))
    words = "P, the principal axes of the target (Jxx >= Jyy >= Jzz), origin at its centre of mass"
    return Placement("P", X_PG, words), warnings


def _cad_frame(options: ExportOptions, surface: SurfaceModel | None) -> tuple[Placement, list[str]]:
    """The CAD frame by corresponding points, by the surfaces, or by the surfaces from those points on."""
    found, unit_m = None, METRES[options.cad_unit]
    if options.cad_points is not None:
        found, by, file = _from_points(options.cad_points, unit_m), "corresponding points", options.cad_points
    if options.cad is not None:
        if surface is None or len(surface.mesh.faces) == 0:
            raise InputError("--cad: this run has no mesh to lay on the model; give --cad-points FILE")
        model, scan = read_mesh(options.cad, unit_m), surface.mesh
        if not SIZES[0] < float(model.scale / scan.scale) < SIZES[1]:
            raise InputError(
                f"{options.cad}: {model.scale:.3g} m across, and the run's mesh is {scan.scale:.3g} m: "
                "check --cad-unit, m or mm"
            )
        found = align_surfaces(scan, model, None if found is None else found.X_cadG)
        by, file = "surface on surface", options.cad
    if found is None:
        raise InputError("--frame cad: give --cad MESH or --cad-points FILE, which define that frame")
    warnings = []
    size = None if surface is None else float(surface.mesh.scale)
    if size is not None and found.rms_m > POOR_SHARE * size:
        warnings.append(
            f"the alignment leaves {1e3 * found.rms_m:.3g} mm rms, {found.rms_m / size:.0%} of the body's "
            "size: look at the result; --cad-points sets its start"
        )
    if found.rival_deg is not None:
        warnings.append(
            f"the model fits as well turned by {found.rival_deg:.0f} deg: the scan cannot distinguish them; "
            "--cad-points resolves the ambiguity"
        )
    words = f"that of the CAD model; {file.name}, aligned by {by}; {1e3 * found.rms_m:.3g} mm rms residual"
    return Placement("cad", found.X_cadG, words), warnings


def _from_points(file: Path, cad_m: float) -> CadAlignment:
    table = [row for _, row in number_rows(file, 6, POINT_COLUMNS, MAX_POINTS)]
    points = np.array(table).reshape(-1, 6)
    if len(points) and np.abs(points).max() > MAX_COORDINATE:
        raise InputError(f"{file}: a coordinate above {MAX_COORDINATE:g}; correct it")
    try:
        return align_points(points[:, :3], cad_m * points[:, 3:])
    except ValueError as error:
        raise InputError(f"{file}: {error}; each line has {POINT_COLUMNS}") from error
