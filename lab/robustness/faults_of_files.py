"""Faults of images, times, calibration and poses of a recorded scene: from a recording to a recording."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lab.robustness.recording import Images, Recording
from polhode.geometry.lie import Array, Bools, exp_so3, make_pose

Change = Callable[[Recording, np.random.Generator], Recording]

READ_NOISE_DN, BLACK_DN = 0.8, 1.0
"""Of the simulated sensor: what a sensor gives where no light falls"""


def dropped(share: float) -> Change:
    """A share of the frames is missing, at random; the first and the last one stay."""

    def change(recording: Recording, rng: np.random.Generator) -> Recording:
        inner = 1 + rng.permutation(len(recording) - 2)
        lost = inner[: round(share * len(recording))]
        return recording.kept(~np.isin(np.arange(len(recording)), lost))

    return change


def burst(seconds: float) -> Change:
    """All frames of so many seconds in the middle are missing."""
    return lambda recording, rng: recording.kept(~_middle(recording, seconds))


def dead_camera(recording: Recording, rng: np.random.Generator) -> Recording:
    """The left or the right camera shows nothing but noise for 5 s."""
    dark = _middle(recording, 5.0)
    side = "left" if rng.random() < 0.5 else "right"
    images = getattr(recording, side).copy()
    images[dark] = _noise(images[dark].shape, rng)
    return replace(recording, **{side: images})


def eclipse(recording: Recording, rng: np.random.Generator) -> Recording:
    """No light at all for 6 s, with a second of penumbra before and after."""
    t_s = (recording.stamps_ns - recording.stamps_ns[0]) * 1e-9
    middle_s = 0.5 * t_s[-1]
    light = np.clip(np.abs(t_s - middle_s) - 3.0, 0.0, 1.0)[:, None, None]
    return _changed(
        recording, lambda images: _digital(light * (images - BLACK_DN) + BLACK_DN, rng, light < 1.0)
    )


def sides_exchanged(recording: Recording, rng: np.random.Generator) -> Recording:
    """Left and right image are exchanged in a fifth of the pairs."""
    chosen = _chosen(len(recording), 0.2, rng)[:, None, None]
    left = np.where(chosen, recording.right, recording.left)
    return replace(recording, left=left, right=np.where(chosen, recording.left, recording.right))


def order_exchanged(recording: Recording, rng: np.random.Generator) -> Recording:
    """Two successive pairs are exchanged, at four places."""
    order = np.arange(len(recording))
    for place in 2 + 2 * rng.permutation(len(recording) // 2 - 2)[:4]:
        order[[place, place + 1]] = order[[place + 1, place]]
    return replace(recording, left=recording.left[order], right=recording.right[order])


def clock_jumps(recording: Recording, rng: np.random.Generator) -> Recording:
    """The clock jumps ahead by 0.8 s, and later back by 0.3 s."""
    later = np.zeros(len(recording), dtype=np.int64)
    later[round(0.4 * len(later)) :] += 800_000_000
    later[round(0.7 * len(later)) :] -= 300_000_000
    return replace(recording, stamps_ns=recording.stamps_ns + later)


def exposure_jumps(recording: Recording, rng: np.random.Generator) -> Recording:
    """The exposure jumps five times, to between 0.35 and 2.2 times what it should be."""
    gain = np.ones((len(recording), 1, 1))
    for place in np.sort(rng.permutation(len(recording))[:5]):
        gain[place:] = np.exp(rng.uniform(np.log(0.35), np.log(2.2)))
    return _changed(recording, lambda images: _digital(gain * images, rng, gain < 1.0))


def saturation(recording: Recording, rng: np.random.Generator) -> Recording:
    """Exposed four times too long."""
    return _changed(recording, lambda images: _digital(4.0 * images, rng, None))


def dead_columns(recording: Recording, rng: np.random.Generator) -> Recording:
    """Eight columns of each camera always show one value."""

    def change(images: Images) -> Images:
        out = images.copy()
        columns = rng.permutation(images.shape[2])[:8]
        out[:, :, columns] = rng.integers(0, 256, 8)
        return out

    return _changed(recording, change)


def dust(recording: Recording, rng: np.random.Generator) -> Recording:
    """Thirty grains on each sensor, of 2 to 6 px, take 30 to 80 % of the light."""

    def change(images: Images) -> Images:
        height, width = images.shape[1:]
        v, u = np.mgrid[:height, :width]
        passes = np.ones((height, width))
        for _ in range(30):
            at, radius, taken = (
                rng.uniform([0, 0], [width, height]),
                rng.uniform(1.0, 3.0),
                rng.uniform(0.3, 0.8),
            )
            passes *= 1.0 - taken * np.exp(-0.5 * ((u - at[0]) ** 2 + (v - at[1]) ** 2) / radius**2)
        return _digital(passes * images, rng, None)

    return _changed(recording, change)


def blur(recording: Recording, rng: np.random.Generator) -> Recording:
    """Out of focus: a standard deviation of 2 px."""

    def change(images: Images) -> Images:
        return _digital(
            np.stack([cv2.GaussianBlur(each.astype(np.float64), (0, 0), 2.0) for each in images]), rng, True
        )

    return _changed(recording, change)


def knocked(axis: tuple[float, float, float], degrees: float = 0.2) -> Change:
    """The right camera is turned about an axis of its own, half way through; the calibration stays."""

    def change(recording: Recording, rng: np.random.Generator) -> Recording:
        K, half = recording.true_K, len(recording) // 2
        H = K @ exp_so3(np.deg2rad(degrees) * np.array(axis)) @ np.linalg.inv(K)
        size = (recording.right.shape[2], recording.right.shape[1])
        flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
        turned = [cv2.warpPerspective(each, H, size, flags=flags) for each in recording.right[half:]]
        return replace(recording, right=np.concatenate([recording.right[:half], np.stack(turned)]))

    return change


def focal_wrong(recording: Recording, rng: np.random.Generator) -> Recording:
    """The calibration states a focal length that is 0.5 % too long, of both cameras."""
    return replace(recording, focal_px=1.005 * recording.focal_px)


def poses_wrong(recording: Recording, rng: np.random.Generator) -> Recording:
    """Half of the inspector's reported attitudes are off by 1 degree, where 0.02 is stated."""
    F = len(recording)
    theta = np.deg2rad(0.02) * rng.standard_normal((F, 3))
    axis = rng.standard_normal((F, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    theta += np.deg2rad(1.0) * axis * _chosen(F, 0.5, rng)[:, None]
    return replace(recording, X_NB=make_pose(exp_so3(theta), np.zeros((F, 3))), sigma_theta_deg=0.02)


def plume(recording: Recording, rng: np.random.Generator) -> Recording:
    """A cloud of particles leaves the target for 8 s, brighter than most of it."""
    F = len(recording)
    t_s = (recording.stamps_ns - recording.stamps_ns[0]) * 1e-9
    start_s, count = 0.35 * t_s[-1], 1500
    born_s = start_s + rng.uniform(0.0, 8.0, count)
    aim = rng.standard_normal(3)
    aim /= np.linalg.norm(aim)
    v_N = 0.05 * (aim + 0.25 * rng.standard_normal((count, 3)))
    source_N = np.stack([np.interp(born_s, t_s, recording.truth.r_N[:, k]) for k in range(3)], axis=1)
    images = [recording.left.astype(np.float64), recording.right.astype(np.float64)]
    K, shape = recording.true_K, recording.left.shape[1:]
    for k in range(F):
        age_s = t_s[k] - born_s
        there = (age_s > 0.0) & (age_s < 6.0)
        p_N = source_N[there] + v_N[there] * age_s[there, None]
        for side in range(2):
            p_C = p_N - [side * recording.baseline_m, 0.0, 0.0]
            uv = p_C @ K.T
            light = _splats(uv[:, :2] / uv[:, 2:], 120.0 / (1.0 + 2.0 * age_s[there]), shape)
            images[side][k] += cv2.GaussianBlur(light, (0, 0), 2.5)
    left, right = (_digital(each, rng, None) for each in images)
    return replace(recording, left=left, right=right)


def _splats(uv_px: Array, light: Array, shape: tuple[int, ...]) -> Array:
    """Light (n,) in the pixels (n, 2) of an image; each is ten pixels' worth."""
    out, at = np.zeros(shape), np.round(uv_px).astype(np.int64)
    inside = ((at >= 0) & (at < [shape[1], shape[0]])).all(axis=1)
    np.add.at(out, (at[inside, 1], at[inside, 0]), 10.0 * light[inside])
    return out


def _middle(recording: Recording, seconds: float) -> Bools:
    """The frames (F,) of so many seconds in the middle."""
    t_s = (recording.stamps_ns - recording.stamps_ns[0]) * 1e-9
    return np.asarray(np.abs(t_s - 0.5 * t_s[-1]) < 0.5 * seconds)


def _chosen(count: int, share: float, rng: np.random.Generator) -> Bools:
    """A share of the frames, not the first one."""
    return np.isin(np.arange(count), 1 + rng.permutation(count - 1)[: round(share * count)])


def _changed(recording: Recording, change: Callable[[Images], Images]) -> Recording:
    return replace(recording, left=change(recording.left), right=change(recording.right))


def _noise(shape: tuple[int, ...], rng: np.random.Generator) -> Images:
    return _digital(np.full(shape, BLACK_DN), rng, True)


def _digital(
    values: NDArray[np.floating[Any]], rng: np.random.Generator, noisy: Bools | bool | None
) -> Images:
    """Grey values; with read noise of its own where what was there is weakened."""
    if noisy is not None:
        values = values + noisy * READ_NOISE_DN * rng.standard_normal(values.shape)
    return np.asarray(np.clip(np.rint(values), 0, 255), dtype=np.uint8)
