"""A body in words: its size in metres, so that a wrong scale is seen."""

import numpy as np

from polhode.simulation.bodies.parts.part import Body


def describe(body: Body) -> str:
    """One line: extents [m], faces, drawings, materials, and the parts by volume [m^3]."""
    sides = " x ".join(f"{side:.3g}" for side in np.ptp(np.asarray(body.mesh.vertices), axis=0))
    ordered = sorted(body.parts, key=lambda part: -part.volume_m3)
    listed = [f"{part.name} {part.volume_m3:.3g} m^3" for part in ordered[:6]]
    if len(ordered) > 6:
        listed.append(f"{len(ordered) - 6} more")
    return (
        f"body {sides} m along x, y, z; {len(body.mesh.faces)} faces, {len(body.charts)} drawings, "
        f"{len(body.materials)} materials; parts: {', '.join(listed)}"
    )
