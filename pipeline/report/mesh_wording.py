"""Words and numbers of the report about the dense model: the mesh, its coverage, mass against volume."""

from polhode.pipeline.report.wording import Row
from polhode.pipeline.run_directory.summary import Summary


def mesh_rows(summary: Summary) -> list[Row]:
    """Empty where there is no mesh."""
    rows = []
    if (mesh := summary.mesh) is not None:
        invented = f"{mesh.invented_faces} ({mesh.invented_share:.2%} of the area)"
        rows += [
            Row("faces", f"{mesh.faces}, {'closed' if mesh.closed else 'open'}"),
            Row("small holes closed, left open", f"{mesh.holes_closed}, {mesh.holes_left_open}"),
            Row("faces invented for them", invented),
            Row("colours", "the Sun's shading divided out" if mesh.colour == "albedo" else "as the images"),
        ]
        if (sun := mesh.sun) is not None:
            direction = ", ".join(f"{part:.3f}" for part in sun.direction_N)
            sure = "" if sun.sigma_deg is None else f" ± {sun.sigma_deg:.1f} deg"
            used = "" if mesh.colour == "albedo" else ", not used"
            rows.append(Row("direction of the Sun in N", f"{direction}{sure}"))
            rows.append(Row("changes of brightness it explains", f"{sun.explained:.0%}{used}"))
        for level in mesh.levels:
            mean_mm, most_mm = 1e3 * level.mean_distance_m, 1e3 * level.largest_distance_m
            away = f"off by {mean_mm:.2g} mm in the mean, {most_mm:.2g} mm at most"
            rows.append(Row(level.file, f"{level.faces} faces, {away}"))
    if (coverage := summary.coverage) is not None:
        of = "surface" if coverage.of == "mesh" else "convex hull"
        rows.append(
            Row(
                f"share of the {of} seen lit, seen unlit, unseen",
                ", ".join(f"{part:.1%}" for part in (coverage.seen, coverage.seen_unlit, coverage.unseen)),
            )
        )
    return rows


def mesh_sentences(summary: Summary) -> list[str]:
    """What was not seen, and how the mass lies in the volume."""
    sentences = [] if summary.coverage is None else [summary.coverage.words]
    return [*sentences, *(summary.physics.words if summary.physics is not None else ())]
