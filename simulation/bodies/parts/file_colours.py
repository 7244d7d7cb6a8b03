"""Colours of a mesh file as reflectances: an image with texture coordinates, or values at corners."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from polhode.compiled import compiled
from polhode.lie import Array
from polhode.records import Ints


@dataclass(frozen=True)
class FileColours:
    """Reflectances of F faces. A face has an image, or values at its corners, or nothing (NaN)."""

    corner_reflectance: Array
    """(F, 3) at the corners; with an image, a factor on it; NaN: no colour"""
    face_image: Ints
    """(F,) index into images, -1: none"""
    corner_uv: Array
    """(F, 3, 2) texture coordinates, v upwards; repeats outside [0, 1]"""
    images: tuple[NDArray[np.float32], ...] = ()
    """(h, w) reflectance each"""

    def look_up(self, face: Ints, weights: Array) -> Array:
        """Reflectance (n,) at faces (n,) with weights (n, 3) of the corners; NaN without a colour."""
        tables = (self.corner_reflectance, self.face_image, self.corner_uv)
        return np.asarray(_look_up(face, np.ascontiguousarray(weights), *tables, *self._packed))

    @cached_property
    def _packed(self) -> tuple[Ints, Ints, NDArray[np.float32]]:
        return packed_images(self.images)

    @staticmethod
    def joined(pieces: "list[tuple[FileColours | None, int]]") -> "FileColours":
        """Colours of several parts, given with their numbers of faces; None: a part without colours."""
        images: list[NDArray[np.float32]] = []
        corners, face_image, uv = [], [], []
        for colours, count in pieces:
            if colours is None:
                colours = FileColours.absent(count)
            corners.append(colours.corner_reflectance)
            face_image.append(np.where(colours.face_image >= 0, colours.face_image + len(images), -1))
            uv.append(colours.corner_uv)
            images += colours.images
        return FileColours(
            np.concatenate(corners), np.concatenate(face_image), np.concatenate(uv), tuple(images)
        )

    @staticmethod
    def absent(faces: int) -> "FileColours":
        """No colour on any face."""
        return FileColours(
            np.full((faces, 3), np.nan), np.full(faces, -1, dtype=np.int64), np.zeros((faces, 3, 2))
        )


def packed_images(images: Sequence[NDArray[np.float32]]) -> tuple[Ints, Ints, NDArray[np.float32]]:
    """Start of each image (n + 1,) in a common buffer, the images' shapes (n, 2), and the buffer."""
    start = np.cumsum([0, *(image.size for image in images)], dtype=np.int64)
    shape = np.array([image.shape for image in images], dtype=np.int64).reshape(-1, 2)
    return start, shape, np.concatenate([np.zeros(0, np.float32), *(image.ravel() for image in images)])


@compiled
def _look_up(
    face: Ints,
    weights: Array,
    corners: Array,
    face_image: Ints,
    corner_uv: Array,
    start: Ints,
    shape: Ints,
    texels: NDArray[np.float32],
) -> Array:
    out = np.empty(len(face))
    for n in range(len(face)):
        f = face[n]
        value = 0.0
        for c in range(3):
            value += weights[n, c] * corners[f, c]
        image = face_image[f]
        if image >= 0:
            height, width = shape[image]
            u, v = 0.0, 0.0
            for c in range(3):
                u += weights[n, c] * corner_uv[f, c, 0]
                v += weights[n, c] * corner_uv[f, c, 1]
            # Texel centres are at half integers; rows increase downwards, v upwards; the image repeats.
            column, row = u * width - 0.5, (1.0 - v) * height - 0.5
            j, i = int(np.floor(column)), int(np.floor(row))
            b, a = column - j, row - i
            left, right = j % width, (j + 1) % width
            top, bottom = start[image] + (i % height) * width, start[image] + ((i + 1) % height) * width
            above = (1 - b) * texels[top + left] + b * texels[top + right]
            below = (1 - b) * texels[bottom + left] + b * texels[bottom + right]
            value *= (1 - a) * above + a * below
        out[n] = value
    return out
