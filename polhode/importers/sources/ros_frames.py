"""The tree of frames of ROS (tf): fixed transforms, and those that change with time."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, make_pose
from polhode.importers.sources.ros_messages import header_ns, rigid


@dataclass
class Edge:
    """A frame in its parent."""

    parent: str
    is_static: bool
    times_ns: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    """(4, 4) each, of the child in the parent"""


@dataclass
class Frames:
    """The tree, child -> edge to its parent."""

    edges: dict[str, Edge] = field(default_factory=dict)

    def add(self, message: Any, is_static: bool, name: str) -> None:
        """Take over a TFMessage. Raises InputError for a transform that is none."""
        for transform in message.transforms:
            child = plain(transform.child_frame_id)
            edge = self.edges.setdefault(child, Edge(plain(transform.header.frame_id), is_static))
            if edge.is_static and edge.poses:
                continue
            edge.times_ns.append(header_ns(transform))
            edge.poses.append(rigid(transform.transform, f"{name}, frame {child}"))

    def fixed(self, a: str, b: str) -> Array | None:
        """(4, 4) frame b in frame a by fixed transforms alone; None: they are not linked by such."""
        chain = self._chain(plain(a), plain(b))
        if chain is None or any(not edge.is_static for edge, _ in chain):
            return None
        X = np.eye(4)
        for edge, forward in chain:
            X = X @ (edge.poses[0] if forward else inverse_pose(edge.poses[0]))
        return X

    def over_time(self, a: str, b: str, times_ns: Ints) -> tuple[Array, Bools] | None:
        """(n, 4, 4) frame b in frame a, and (n,) where transforms cover the time; None: not linked."""
        chain = self._chain(plain(a), plain(b))
        if chain is None:
            return None
        X, covered = np.tile(np.eye(4), (len(times_ns), 1, 1)), np.ones(len(times_ns), dtype=np.bool_)
        for edge, forward in chain:
            at, inside = _interpolated(edge, times_ns)
            X, covered = X @ (at if forward else inverse_pose(at)), covered & inside
        return X, covered

    def names(self) -> list[str]:
        """All frames, sorted."""
        return sorted({*self.edges, *(edge.parent for edge in self.edges.values())})

    def _chain(self, a: str, b: str) -> list[tuple[Edge, bool]] | None:
        """Edges whose product is the pose of b in a; true: from parent to child."""
        up, down = self._to_root(a), self._to_root(b)
        common = next((name for name in up if name in down), None)
        if common is None:
            return None
        rising = [(self.edges[name], False) for name in up[: up.index(common)]]
        falling = [(self.edges[name], True) for name in reversed(down[: down.index(common)])]
        return rising + falling

    def _to_root(self, name: str) -> list[str]:
        names = [name]
        while name in self.edges and len(names) <= len(self.edges):
            name = self.edges[name].parent
            names.append(name)
        return names


def plain(name: str) -> str:
    """A frame's name without the slash that earlier versions of tf begin with."""
    return str(name).removeprefix("/")


def _interpolated(edge: Edge, times_ns: Ints) -> tuple[Array, Bools]:
    """An edge at the times: position linear, attitude by slerp; the nearest one where it has none."""
    if edge.is_static or len(edge.poses) == 1:
        inside = np.full(len(times_ns), edge.is_static) | (times_ns == edge.times_ns[0])
        return np.repeat(edge.poses[0][None], len(times_ns), axis=0), inside
    own, first = np.unique(np.array(edge.times_ns, dtype=np.int64), return_index=True)
    poses = np.stack(edge.poses)[first]
    if len(own) == 1:
        return np.repeat(poses, len(times_ns), axis=0), times_ns == own[0]
    # differences in int64 first: nanoseconds since 1970 do not fit the 53 bits of a double
    inside = (times_ns >= own[0]) & (times_ns <= own[-1])
    t_own = (own - own[0]).astype(np.float64)
    t = np.clip((times_ns - own[0]).astype(np.float64), 0.0, t_own[-1])
    p = np.stack([np.interp(t, t_own, column) for column in poses[:, :3, 3].T], axis=-1)
    return np.asarray(
        make_pose(Slerp(t_own, Rotation.from_matrix(poses[:, :3, :3]))(t).as_matrix(), p)
    ), inside
