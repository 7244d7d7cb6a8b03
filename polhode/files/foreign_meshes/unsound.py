"""Why a file of a mesh is not read, and limits that several formats share."""

from dataclasses import dataclass

from polhode.files.foreign_files import MIB

MAX_PIECES = 2_000
"""Meshes in one file; each costs trimesh a fraction of a millisecond."""


@dataclass(frozen=True)
class MeshLimits:
    """How large a file of triangles may be."""

    binary_bytes: int
    rows: int
    """Of a binary PLY: vertices, faces and all else"""
    faces: int


FOREIGN = MeshLimits(64 * MIB, 4_000_000, 2_000_000)
"""Of a file that anybody may have written"""
OF_A_RUN = MeshLimits(1024 * MIB, 60_000_000, 30_000_000)
"""Of what a run wrote: more than a field of the default size (``mapping.memory_mib``) can give"""


class Unsound(Exception):
    """The reason, as part of a sentence."""


def require_pieces(count: int) -> None:
    """Raises Unsound."""
    if count > MAX_PIECES:
        raise Unsound(f"{count} pieces, where {MAX_PIECES} are allowed: join some")
