"""Why a file of a mesh is not read, and limits that several formats share."""

MAX_PIECES = 2_000
"""Meshes in one file; each costs trimesh a fraction of a millisecond."""
MAX_FACES = 2_000_000


class Unsound(Exception):
    """The reason, as part of a sentence."""


def require_pieces(count: int) -> None:
    """Raises Unsound."""
    if count > MAX_PIECES:
        raise Unsound(f"{count} pieces, where {MAX_PIECES} are allowed: join some")
