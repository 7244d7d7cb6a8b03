"""URDF, MJCF and SDF: the target as a free rigid body, with its inertia, surface and convex pieces.

The link frame is F. Inertial tags: origin at the centre of mass, axes P, so the products of inertia are
zero. Meshes are separate files, named by paths relative to the XML. Lengths are metres, as all three demand.
URDF: wiki.ros.org/urdf/XML. MJCF: mujoco.readthedocs.io, XML reference. SDF 1.9: sdformat.org.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from polhode.geometry.lie import Array, wxyz_from_matrix
from polhode.planning.exports.records import Inertial, LastState

Attributes = dict[str, str]


@dataclass(frozen=True)
class Robot:
    """The content of the three formats."""

    name: str
    folder: str
    """Of the mesh files, relative to the XML"""
    visual: str | None
    """File name of the surface; None: there is none"""
    collision: tuple[str, ...]
    """File names of the convex pieces"""
    inertial: Inertial | None
    """None: nothing is known"""
    state: LastState | None
    """None: no motion is known; the body rests at the origin"""
    comments: tuple[str, ...]


def urdf(robot: Robot) -> str:
    """A floating joint carries the link in N, at the last pose of the run."""
    root = ET.Element("robot", name=robot.name)
    _comments(root, robot.comments)
    # MuJoCo otherwise looks for meshes beside the file, not in their folder
    compiler = ET.SubElement(ET.SubElement(root, "mujoco"), "compiler")
    compiler.attrib |= {"strippath": "false", "balanceinertia": "false"}
    # simulators know this name; the link is N
    ET.SubElement(root, "link", name="world")
    joint = ET.SubElement(root, "joint", name="N_to_target", type="floating")
    X_NF = np.eye(4) if robot.state is None else robot.state.X_NF
    ET.SubElement(joint, "origin", _xyz_rpy(X_NF[:3, 3], X_NF[:3, :3]))
    ET.SubElement(joint, "parent", link="world")
    ET.SubElement(joint, "child", link=robot.name)
    link = ET.SubElement(root, "link", name=robot.name)
    if robot.inertial is not None:
        own = ET.SubElement(link, "inertial")
        ET.SubElement(own, "origin", _xyz_rpy(robot.inertial.com_F, robot.inertial.R_FP))
        ET.SubElement(own, "mass", value=repr(robot.inertial.mass_kg))
        ET.SubElement(own, "inertia", _moments(robot.inertial))
    for tag, files in (("visual", _visual(robot)), ("collision", robot.collision)):
        for file in files:
            part = ET.SubElement(link, tag, name=file.partition(".")[0])
            ET.SubElement(part, "origin", xyz="0 0 0", rpy="0 0 0")
            ET.SubElement(ET.SubElement(part, "geometry"), "mesh", filename=f"{robot.folder}/{file}")
    return _text(root)


def mjcf(robot: Robot) -> str:
    """A free body without gravity; the key frame ``last`` is the last state of the run."""
    root = ET.Element("mujoco", model=robot.name)
    _comments(root, robot.comments)
    from_geometry = "true" if robot.inertial is None else "false"
    ET.SubElement(root, "compiler", angle="radian", meshdir=robot.folder, inertiafromgeom=from_geometry)
    ET.SubElement(root, "option", gravity="0 0 0", integrator="RK4", timestep="0.002")
    files = [*_visual(robot), *robot.collision]
    if files:
        asset = ET.SubElement(root, "asset")
        for file in files:
            kind = "convex" if file in robot.collision else "shell"
            ET.SubElement(asset, "mesh", name=file.partition(".")[0], file=file, inertia=kind)
    state = robot.state
    X_NF = np.eye(4) if state is None else state.X_NF
    world = ET.SubElement(root, "worldbody")
    body = ET.SubElement(world, "body", {"name": robot.name} | _pos_quat(X_NF[:3, 3], X_NF[:3, :3]))
    ET.SubElement(body, "freejoint", name=f"N_to_{robot.name}")
    if robot.inertial is not None:
        own, at = robot.inertial, _pos_quat(robot.inertial.com_F, robot.inertial.R_FP)
        values = {"mass": repr(own.mass_kg), "diaginertia": _row(own.moments_kg_m2)}
        ET.SubElement(body, "inertial", at | values)
        ET.SubElement(body, "site", {"name": "P"} | at | {"size": "0.005"})
    shown = {"group": "2", "contype": "0", "conaffinity": "0"}
    for file in files:
        name, more = file.partition(".")[0], {"group": "3"} if file in robot.collision else shown
        ET.SubElement(body, "geom", {"name": name, "type": "mesh", "mesh": name} | more)
    if state is not None:
        pose = np.concatenate([X_NF[:3, 3], wxyz_from_matrix(X_NF[:3, :3])])
        # a free joint's rates: velocity of the body's origin along the world, angular velocity along the body
        rates = np.concatenate([state.v_N, state.w_F])
        keys = ET.SubElement(root, "keyframe")
        ET.SubElement(keys, "key", name="last", qpos=_row(pose), qvel=_row(rates))
    return _text(root)


def sdf(robot: Robot) -> str:
    """A model with one link, without gravity, at the last pose; the frame ``P`` is attached to it."""
    root = ET.Element("sdf", version="1.9")
    _comments(root, robot.comments)
    model = ET.SubElement(root, "model", name=robot.name)
    X_NF = np.eye(4) if robot.state is None else robot.state.X_NF
    ET.SubElement(model, "pose").text = _sdf_pose(X_NF[:3, 3], X_NF[:3, :3])
    link = ET.SubElement(model, "link", name="link")
    ET.SubElement(link, "gravity").text = "false"
    if robot.inertial is not None:
        own = robot.inertial
        tag = ET.SubElement(link, "inertial")
        ET.SubElement(tag, "pose").text = _sdf_pose(own.com_F, own.R_FP)
        ET.SubElement(tag, "mass").text = repr(own.mass_kg)
        inertia = ET.SubElement(tag, "inertia")
        for key, value in _moments(own).items():
            ET.SubElement(inertia, key).text = value
    for kind, files in (("visual", _visual(robot)), ("collision", robot.collision)):
        for file in files:
            part = ET.SubElement(link, kind, name=file.partition(".")[0])
            mesh = ET.SubElement(ET.SubElement(part, "geometry"), "mesh")
            ET.SubElement(mesh, "uri").text = f"{robot.folder}/{file}"
    if robot.inertial is not None:
        frame = ET.SubElement(model, "frame", name="P", attached_to="link")
        ET.SubElement(frame, "pose").text = _sdf_pose(robot.inertial.com_F, robot.inertial.R_FP)
    return _text(root)


def describe_state(state: LastState) -> str:
    """The last state, for formats without velocities."""
    return (
        f"last state of the run, at timestamp {state.timestamp_ns} ns, in N: velocity of the link's origin "
        f"{_row(state.v_N)} m/s, angular velocity along the link's axes {_row(state.w_F)} rad/s"
    )


def _visual(robot: Robot) -> tuple[str, ...]:
    return () if robot.visual is None else (robot.visual,)


def _comments(root: ET.Element, comments: Sequence[str]) -> None:
    for text in comments:
        # XML allows no double hyphen inside a comment: options lose theirs
        root.append(ET.Comment(f" {text.replace('--', '')} "))


def _row(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _pos_quat(p: Array, R: Array) -> Attributes:
    return {"pos": _row(p), "quat": _row(wxyz_from_matrix(R))}


def _rpy(R: Array) -> Array:
    """Roll, pitch, yaw about the fixed axes x, y, z [rad]."""
    return np.asarray(Rotation.from_matrix(R).as_euler("xyz"))


def _xyz_rpy(p: Array, R: Array) -> Attributes:
    return {"xyz": _row(p), "rpy": _row(_rpy(R))}


def _sdf_pose(p: Array, R: Array) -> str:
    return f"{_row(p)} {_row(_rpy(R))}"


def _moments(inertial: Inertial) -> Attributes:
    zero = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
    names = ("ixx", "iyy", "izz")
    return dict(zip(names, map(repr, inertial.moments_kg_m2.tolist()), strict=True)) | zero


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
