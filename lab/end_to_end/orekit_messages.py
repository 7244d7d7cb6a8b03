"""Attitude and orbit messages (AEM, OEM) of a run, read by Orekit.

    python -m lab.end_to_end.orekit_messages RUN

Orekit's own parsers read what ``polhode export --to aem`` and ``--to oem`` write; its attitudes and positions
are compared with the same prediction as a TUM trajectory. It needs Java (11 or later) and ``pip install
orekit-jpype``.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tyro.conf import Positional, arg

from lab.command import command, polhode

UTC_IS_TAI_LESS = ((1972, 10), (2017, 37))
"""Seconds from a year's beginning on; the leap seconds between do not matter to intervals after 2017"""


def main(run: Positional[Annotated[Path, arg(metavar="RUN", help="Folder of a run.")]]) -> None:
    """Export, parse, compare."""
    _start_java()
    with TemporaryDirectory() as folder:
        files = {}
        for kind in ("aem", "oem", "tum"):
            files[kind] = Path(folder) / f"motion.{kind}"
            words = ("--frame", "P", "--epoch", "2026-03-01T00:00:00", "-o", files[kind], "--quiet")
            polhode("export", run, "--to", kind, *words)
        rows = np.loadtxt(files["tum"])
        attitudes, positions = _attitudes(files["aem"]), _positions(files["oem"])
    turned = Rotation.from_matrix(attitudes) * Rotation.from_quat(rows[:, 4:])
    print(f"AEM: {len(attitudes)} of {len(rows)} attitudes read by Orekit, apart by at most", end=" ")
    print(f"{np.rad2deg(turned.magnitude().max()):.1e} deg from those of the trajectory")
    apart_m = np.linalg.norm(positions - rows[:, 1:4], axis=1)
    print(f"OEM: {len(positions)} of {len(rows)} positions, apart by at most {apart_m.max():.1e} m")


def _start_java() -> None:
    """Start Java with the leap seconds that Orekit needs to read UTC."""
    import jpype
    import orekit_jpype

    orekit_jpype.initVM()
    from java.util import ArrayList
    from org.orekit.time import DateComponents, OffsetModel, TimeScalesFactory

    offsets = ArrayList()
    for year, seconds in UTC_IS_TAI_LESS:
        offsets.add(OffsetModel(DateComponents(year, 1, 1), seconds))

    @jpype.JImplements("org.orekit.time.UTCTAIOffsetsLoader")
    class Loader:
        """The offsets above."""

        @jpype.JOverride
        def loadOffsets(self) -> Any:
            """The list."""
            return offsets

    TimeScalesFactory.addUTCTAIOffsetsLoader(Loader())


def _attitudes(path: Path) -> NDArray[np.float64]:
    """(n, 3, 3) coordinates in N to those in the body, of all rows."""
    from org.orekit.data import DataSource
    from org.orekit.files.ccsds.ndm import ParserBuilder

    message = ParserBuilder().buildAemParser().parseMessage(DataSource(str(path)))
    found = [
        [list(row) for row in each.getRotation().getMatrix()]
        for segment in message.getSegments()
        for each in segment.getAngularCoordinates()
    ]
    return np.array(found, dtype=np.float64)


def _positions(path: Path) -> NDArray[np.float64]:
    """(n, 3) [m], of all rows."""
    from org.orekit.data import DataSource
    from org.orekit.files.ccsds.ndm import ParserBuilder

    # the message states no central body; positions do not depend on its mass
    message = ParserBuilder().withMu(1.0).buildOemParser().parseMessage(DataSource(str(path)))
    found = [
        list(each.getPosition().toArray())
        for segment in message.getSegments()
        for each in segment.getCoordinates()
    ]
    return np.array(found, dtype=np.float64)


if __name__ == "__main__":
    command(main)
