"""URDF, MJCF and SDF: the target as a free rigid body, with its inertia, surface and convex pieces.

The link frame is F. Inertial tags: origin at the centre of mass, axes P, so the products of inertia are
zero. Meshes are separate files, named by paths relative to the XML. Lengths are metres, as all three demand.
URDF: wiki.ros.org/urdf/XML. MJCF: mujoco.readthedocs.io, XML reference. SDF 1.9: sdformat.org.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from xml.etree.ElementTree import SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from polhode.geometry.lie import Array, wxyz_from_matrix
from polhode.planning.exports.job import LastState
from polhode.planning.exports.mass_properties import Inertial


@dataclass(frozen=True)
class Robot:
    """The content of the three formats."""

    name: str
    folder: str
    """Of the mesh files, relative to the XML"""
    visual: tuple[str, ...]
    """File name of the surface, if there is one"""
    collision: tuple[str, ...]
    """File names of the convex pieces"""
    inertial: Inertial | None
    """None: nothing is known"""
    state: LastState | None
    """None: no motion is known; the body rests at the origin"""
    comments: tuple[str, ...]

    @property
    def X_NF(self) -> Array:
        """(4, 4)"""
        return np.eye(4) if self.state is None else self.state.X_NF

    @property
    def parts(self) -> list[tuple[str, str, str]]:
        """Kind, name and file of each mesh."""
        kinds = (("visual", self.visual), ("collision", self.collision))
        return [(kind, file.partition(".")[0], file) for kind, files in kinds for file in files]

    @property
    def inertia(self) -> dict[str, str]:
        """Of the centre of mass, along P."""
        if self.inertial is None:
            return {}
        xx, yy, zz = map(repr, self.inertial.moments_kg_m2.tolist())
        return {"ixx": xx, "iyy": yy, "izz": zz, "ixy": "0", "ixz": "0", "iyz": "0"}


def urdf(robot: Robot) -> str:
    """A floating joint carries the link in N, at the last pose of the run."""
    root = _root("robot", robot, name=robot.name)
    # MuJoCo otherwise looks for meshes beside the file, not in their folder
    SubElement(SubElement(root, "mujoco"), "compiler", strippath="false", balanceinertia="false")
    # simulators know this name; the link is N
    SubElement(root, "link", name="world")
    joint = SubElement(root, "joint", name="N_to_target", type="floating")
    SubElement(joint, "origin", _xyz_rpy(robot.X_NF))
    SubElement(joint, "parent", link="world")
    SubElement(joint, "child", link=robot.name)
    link = SubElement(root, "link", name=robot.name)
    if robot.inertial is not None:
        own = SubElement(link, "inertial")
        SubElement(own, "origin", _xyz_rpy(robot.inertial.X_FP))
        SubElement(own, "mass", value=repr(robot.inertial.mass_kg))
        SubElement(own, "inertia", robot.inertia)
    for kind, name, file in robot.parts:
        part = SubElement(link, kind, name=name)
        SubElement(part, "origin", xyz="0 0 0", rpy="0 0 0")
        SubElement(SubElement(part, "geometry"), "mesh", filename=f"{robot.folder}/{file}")
    return _text(root)


def mjcf(robot: Robot) -> str:
    """A free body without gravity; the key frame ``last`` is the last state of the run."""
    root, own = _root("mujoco", robot, model=robot.name), robot.inertial
    from_geometry = "true" if own is None else "false"
    SubElement(root, "compiler", angle="radian", meshdir=robot.folder, inertiafromgeom=from_geometry)
    SubElement(root, "option", gravity="0 0 0", integrator="RK4", timestep="0.002")
    if robot.parts:
        asset = SubElement(root, "asset")
        for kind, name, file in robot.parts:
            inertia = "convex" if kind == "collision" else "shell"
            SubElement(asset, "mesh", name=name, file=file, inertia=inertia)
    world = SubElement(root, "worldbody")
    body = SubElement(world, "body", {"name": robot.name} | _pos_quat(robot.X_NF))
    SubElement(body, "freejoint", name=f"N_to_{robot.name}")
    if own is not None:
        at, moments = _pos_quat(own.X_FP), _row(own.moments_kg_m2)
        SubElement(body, "inertial", at | {"mass": repr(own.mass_kg), "diaginertia": moments})
        SubElement(body, "site", {"name": "P"} | at | {"size": "0.005"})
    shown = {"group": "2", "contype": "0", "conaffinity": "0"}
    for kind, name, _ in robot.parts:
        more = {"group": "3"} if kind == "collision" else shown
        SubElement(body, "geom", {"name": name, "type": "mesh", "mesh": name} | more)
    if robot.state is not None:
        pose = np.concatenate([robot.X_NF[:3, 3], wxyz_from_matrix(robot.X_NF[:3, :3])])
        # a free joint's rates: velocity of the body's origin along the world, angular velocity along the body
        rates = np.concatenate([robot.state.v_N, robot.state.w_F])
        SubElement(SubElement(root, "keyframe"), "key", name="last", qpos=_row(pose), qvel=_row(rates))
    return _text(root)


def sdf(robot: Robot) -> str:
    """A model with one link, without gravity, at the last pose; the frame ``P`` is attached to it."""
    root, own = _root("sdf", robot, version="1.9"), robot.inertial
    model = SubElement(root, "model", name=robot.name)
    SubElement(model, "pose").text = " ".join(_xyz_rpy(robot.X_NF).values())
    link = SubElement(model, "link", name="link")
    SubElement(link, "gravity").text = "false"
    if own is not None:
        tag = SubElement(link, "inertial")
        SubElement(tag, "pose").text = " ".join(_xyz_rpy(own.X_FP).values())
        SubElement(tag, "mass").text = repr(own.mass_kg)
        inertia = SubElement(tag, "inertia")
        for key, value in robot.inertia.items():
            SubElement(inertia, key).text = value
    for kind, name, file in robot.parts:
        mesh = SubElement(SubElement(SubElement(link, kind, name=name), "geometry"), "mesh")
        SubElement(mesh, "uri").text = f"{robot.folder}/{file}"
    if own is not None:
        frame = SubElement(model, "frame", name="P", attached_to="link")
        SubElement(frame, "pose").text = " ".join(_xyz_rpy(own.X_FP).values())
    return _text(root)


WRITERS: dict[str, Callable[[Robot], str]] = {"urdf": urdf, "mjcf": mjcf, "sdf": sdf}


def describe_state(state: LastState) -> str:
    """The last state, for formats without velocities."""
    return (
        f"last state of the run, at timestamp {state.timestamp_ns} ns, in N: velocity of the link's origin "
        f"{_row(state.v_N)} m/s, angular velocity along the link's axes {_row(state.w_F)} rad/s"
    )


def _root(tag: str, robot: Robot, **attributes: str) -> ET.Element:
    root = ET.Element(tag, attributes)
    for text in robot.comments:
        # XML allows no double hyphen inside a comment: options lose theirs
        root.append(ET.Comment(f" {text.replace('--', '')} "))
    return root


def _row(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _pos_quat(X: Array) -> dict[str, str]:
    return {"pos": _row(X[:3, 3]), "quat": _row(wxyz_from_matrix(X[:3, :3]))}


def _xyz_rpy(X: Array) -> dict[str, str]:
    """With roll, pitch, yaw about the fixed axes x, y, z [rad]."""
    return {"xyz": _row(X[:3, 3]), "rpy": _row(Rotation.from_matrix(X[:3, :3]).as_euler("xyz"))}


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
