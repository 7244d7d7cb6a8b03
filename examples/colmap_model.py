"""A run's sparse map as a model of COLMAP, in its text format: cameras, images with their points, points.

    python -m examples.colmap_model RUN -o DIR [--data SEQ]

With --data, the sequence of the run, DIR/images gets the rectified left images, for COLMAP's dense stereo.
COLMAP's world is the target's frame G, in metres; its camera is the rectified left one, without distortion.
A point is the median of the places where its stereo pairs put it, which a few wrong ones do not move. Points
are those of landmarks.ply: number n is its vertex n - 1. Landmarks that only outliers had seen are left out.
COLMAP puts the centre of the first pixel at (0.5, 0.5), polhode at (0, 0).
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import polhode
from polhode import stages
from polhode.geometry.lie import Array, Ints, inverse_pose, transform_points, wxyz_from_matrix
from polhode.records.dataset_writer import write_png
from polhode.records.tracks import StereoTracks
from polhode.runtime.errors import InputError

CAMERA, GREY = 1, "128 128 128"
PIXEL_CENTRE = 0.5


def main(arguments: list[str] | None = None) -> int:
    """Write the model."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path, help="folder of a run")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the model")
    parser.add_argument("--data", type=Path, help="sequence of the run: write its rectified left images, too")
    options = parser.parse_args(arguments)
    try:
        run = polhode.load(options.run)
        tracks = of_map(run.measurements, run.landmark_numbers)
        files = model_of(tracks, run.X_NG)
        if options.data is not None:
            write_images(options.data, run, options.output / "images")
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return InputError.exit_code
    options.output.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (options.output / name).write_text(text)
    print(f"{tracks.n_frames} images, {tracks.n_landmarks} points: {options.output}")
    return 0


def of_map(tracks: StereoTracks, numbers: Ints) -> StereoTracks:
    """The tracks of the landmarks of the map, numbered by its rows; numbers (L,): theirs in the tracks."""
    kept = np.isin(tracks.landmark, numbers)
    return replace(
        tracks,
        frame=tracks.frame[kept],
        landmark=np.searchsorted(numbers, tracks.landmark[kept]),
        uvd_px=tracks.uvd_px[kept],
        sigma_px=tracks.sigma_px[kept],
    )


def write_images(data: Path, run: polhode.Run, folder: Path) -> None:
    """The rectified left images of the run's sequence, named as in images.txt. Raises InputError."""
    context = stages.open_sequence(data, run.folder / "config.yaml")
    tracks = run.measurements
    if context.rig != tracks.rig or not np.array_equal(context.sequence.timestamps_ns, tracks.timestamps_ns):
        raise InputError(f"{data}: not the sequence of {run.folder}, whose times or calibration are others")
    for k, stamp in enumerate(tracks.timestamps_ns):
        write_png(folder / f"{stamp}.png", stages.rectified_pair(context, k).left)


def model_of(tracks: StereoTracks, X_NG: Array) -> dict[str, str]:
    """Texts by file; X_NG (F, 4, 4) poses of the target."""
    X_RG = inverse_pose(tracks.X_NR) @ X_NG
    return {
        "cameras.txt": _cameras(tracks),
        "images.txt": _images(tracks, X_RG),
        "points3D.txt": _points(tracks, X_RG),
    }


def _cameras(tracks: StereoTracks) -> str:
    rig = tracks.rig
    focal, centre = f"{rig.focal_px!r}", f"{rig.cx_px + PIXEL_CENTRE!r} {rig.cy_px + PIXEL_CENTRE!r}"
    return f"{CAMERA} PINHOLE {rig.width_px} {rig.height_px} {focal} {focal} {centre}\n"


def _images(tracks: StereoTracks, X_RG: Array) -> str:
    """Two lines an image: pose of the world in the camera and name; points as u, v and the point's number."""
    lines = []
    for k, stamp in enumerate(tracks.timestamps_ns):
        pose = [*wxyz_from_matrix(X_RG[k, :3, :3]), *X_RG[k, :3, 3]]
        lines.append(f"{k + 1} {' '.join(f'{value:.12g}' for value in pose)} {CAMERA} {stamp}.png")
        uv, landmark = tracks.uvd_px[tracks.frame == k, :2], tracks.landmark[tracks.frame == k]
        points = zip(uv + PIXEL_CENTRE, landmark, strict=True)
        lines.append(" ".join(f"{u:.6f} {v:.6f} {number + 1}" for (u, v), number in points))
    return "\n".join(lines) + "\n"


def _points(tracks: StereoTracks, X_RG: Array) -> str:
    """A line a point: position, colour, mean distance of its images [px], and where it was seen."""
    p_R = tracks.rig.triangulate(tracks.uvd_px)
    p_G = transform_points(inverse_pose(X_RG)[tracks.frame], p_R[:, None, :])[:, 0]
    lines, place = [], _place_in_image(tracks)
    for number in np.unique(tracks.landmark):
        own = np.flatnonzero(tracks.landmark == number)
        point = np.median(p_G[own], axis=0)
        seen = tracks.rig.project(transform_points(X_RG[tracks.frame[own]], point[None, None, :])[:, 0])
        error = np.linalg.norm((seen - tracks.uvd_px[own])[:, :2], axis=1).mean()
        position = " ".join(f"{value:.9g}" for value in point)
        track = " ".join(f"{tracks.frame[m] + 1} {place[m]}" for m in own)
        lines.append(f"{number + 1} {position} {GREY} {error:.4f} {track}")
    return "\n".join(lines) + "\n"


def _place_in_image(tracks: StereoTracks) -> Ints:
    """(M,) index of each observation among those of its image."""
    place = np.zeros(len(tracks.frame), dtype=np.int64)
    for k in range(tracks.n_frames):
        own = np.flatnonzero(tracks.frame == k)
        place[own] = np.arange(len(own))
    return place


if __name__ == "__main__":
    sys.exit(main())
