"""Whether the motion's centre of mass is where a body with this surface can have it.

A uniform density is an assumption, so small differences mean nothing; but a centre of mass that is farther
from the centre of the volume than the body is large belongs to another motion.
"""

import numpy as np

from polhode.pipeline.run_directory.summary_schema import Check, Physics

MAX_OFFSET = 1.0
"""Of the edge of a cube of the same volume"""
CERTAIN = 3.0
"""Standard deviations of the offset that do not count"""


def mesh_check(physics: Physics | None) -> Check:
    """Offset of the centre of mass from that of uniform density, of the components that are determined."""
    check = Check(
        name="centre of mass, away from that of the volume", limit=100.0 * MAX_OFFSET, unit="% of the size"
    )
    if physics is None or physics.com_offset_G is None or physics.com_offset_sigma_m is None:
        return check
    size_m = float(np.cbrt(physics.volume_m3))
    offset_m = float(np.linalg.norm(physics.com_offset_G))
    surely_m = max(offset_m - CERTAIN * physics.com_offset_sigma_m, 0.0)
    return check.judged(
        100.0 * surely_m / size_m,
        f"the centre of mass is {1e3 * offset_m:.3g} mm away from that of the volume, which is "
        f"{1e3 * size_m:.3g} mm large: no body of this surface has it there; motion or surface is wrong",
    )
