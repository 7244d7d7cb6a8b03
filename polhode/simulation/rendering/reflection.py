"""Reflection at a surface: a diffuse term and a GGX lobe, two-sided.

GGX: Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007; joint Smith
shadowing; Schlick's Fresnel. Levels are relative to a white diffuse surface in the same light.
"""

import numpy as np

from polhode.geometry.lie import Array
from polhode.runtime.compiled import compiled
from polhode.simulation.rendering.light import Lights
from polhode.simulation.surface.materials import Surface


@compiled
def glossy(n_l: float, n_v: float, n_h: float, v_h: float, alpha2: float, f0: float) -> float:
    """Level of the specular term times n_l, from cosines between normal, light, viewer and half vector.

    alpha2: square of alpha = roughness^2. With f0 = 0 there is no specular term, at grazing
    angles either.
    """
    if f0 <= 0.0 or n_l <= 0.0:
        return 0.0
    fresnel = f0 + (1.0 - f0) * (1.0 - v_h) ** 5
    core = n_h * n_h * (alpha2 - 1.0) + 1.0
    density = alpha2 / (np.pi * core * core)
    of_viewer = n_l * np.sqrt(n_v * n_v * (1.0 - alpha2) + alpha2)
    of_light = n_v * np.sqrt(n_l * n_l * (1.0 - alpha2) + alpha2)
    return float(np.pi * density * fresnel * 0.5 * n_l / max(of_viewer + of_light, 1e-6))


@compiled
def reflected(
    normal: Array, toward: Array, to_viewer: Array, albedo: Array, f0: Array, alpha2: Array
) -> Array:
    """Level (n,) of unit light from directions (n, 3), at normals (n, 3), seen from directions (n, 3)."""
    out = np.empty(len(normal))
    for i in range(len(normal)):
        n, t, v = normal[i], toward[i], to_viewer[i]
        n_l = n[0] * t[0] + n[1] * t[1] + n[2] * t[2]
        if n_l <= 0.0:
            out[i] = 0.0
            continue
        n_v = min(max(n[0] * v[0] + n[1] * v[1] + n[2] * v[2], 1e-3), 1.0)
        length = np.sqrt(2.0 + 2.0 * (t[0] * v[0] + t[1] * v[1] + t[2] * v[2]))
        v_h = min(0.5 * length, 1.0)
        n_h = min((n_l + n[0] * v[0] + n[1] * v[1] + n[2] * v[2]) / max(length, 1e-9), 1.0)
        out[i] = min(n_l, 1.0) * albedo[i] * (1.0 - f0[i]) + glossy(
            n_l, n_v, max(n_h, 0.0), v_h, alpha2[i], f0[i]
        )
    return out


def specular_albedo(surface: Surface, to_viewer_G: Array) -> Array:
    """Share (n,) of uniform surroundings that is reflected towards the viewer (directional albedo).

    The fit of Karis, "Physically based shading on mobile", 2014, to the integral of the GGX reflection.
    """
    n_v = np.clip(np.einsum("nk,nk->n", surface.normal_G, to_viewer_G), 0.0, 1.0)
    rough = surface.roughness
    scale = np.minimum((1.0 - rough) ** 2, np.exp2(-9.28 * n_v)) * (1.0 - rough) + 0.0425 - 0.0275 * rough
    share = surface.specular * (1.04 - 0.572 * rough - 1.04 * scale) + 1.04 * scale - 0.04 + 0.022 * rough
    return np.asarray(np.where(surface.specular > 0.0, share, 0.0))


def reflected_earth(surface: Surface, to_viewer_G: Array, lights: Lights) -> Array:
    """Share (n,) of the GGX lobe that the Earth's disc fills, without occlusion."""
    n = surface.normal_G
    mirror = 2.0 * np.einsum("nk,nk->n", n, to_viewer_G)[:, None] * n - to_viewer_G
    return earth_share_of_lobe(mirror, surface.roughness**2, lights)


def earth_share_of_lobe(directions_G: Array, alpha: Array, lights: Lights) -> Array:
    """Share (n,) of GGX lobes around mirrored directions (n, 3) that the Earth's disc fills.

    The edge of the disc is taken as straight: the disc is wide compared with the lobe.
    """
    off_middle = np.arccos(np.clip(directions_G @ lights.earth_direction_G, -1.0, 1.0))
    tilt = np.tan(0.5 * (lights.earth_radius_rad - off_middle))
    return np.asarray(0.5 + 0.5 * tilt / np.sqrt(alpha**2 + tilt**2 + 1e-12))


@compiled
def lobe_ray(
    n: Array, v: Array, alpha: float, f0: float, right: float, up: float
) -> tuple[float, float, float, float]:
    """A mirrored direction (x, y, z) from the lobe of normal n and viewer v (3,), and its weight, at most 1.

    right and up: position in the lobe, on the unit disc. Heitz, "Sampling the GGX distribution of visible
    normals", JCGT 2018, in the frame of the normal and the viewer: x towards the viewer, z along n.
    """
    vz = min(max(n[0] * v[0] + n[1] * v[1] + n[2] * v[2], 1e-3), 1.0)
    vx = np.sqrt(1.0 - vz * vz)
    # The visible normals of a hemisphere, stretched by alpha.
    length = np.sqrt(alpha * alpha * vx * vx + vz * vz)
    sx, sz = alpha * vx / length, vz / length
    up = 0.5 * (1.0 - sz) * np.sqrt(max(1.0 - right * right, 0.0)) + 0.5 * (1.0 + sz) * up
    out = np.sqrt(max(1.0 - right * right - up * up, 0.0))
    hx, hy, hz = alpha * (out * sx - up * sz), alpha * right, max(out * sz + up * sx, 1e-6)
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hy, hz = hx / length, hy / length, hz / length
    v_h = vx * hx + vz * hz
    lx, ly, lz = 2.0 * v_h * hx - vx, 2.0 * v_h * hy, 2.0 * v_h * hz - vz
    weight = 0.0
    if lz > 0.0 and v_h > 0.0:
        a2 = alpha * alpha
        to_v, to_l = np.sqrt(a2 + (1.0 - a2) * vz * vz), np.sqrt(a2 + (1.0 - a2) * lz * lz)
        dark = 1.0 - min(v_h, 1.0)
        fresnel = f0 + (1.0 - f0) * dark * dark * dark * dark * dark
        weight = fresnel * lz * (vz + to_v) / (vz * to_l + lz * to_v)
    x0, x1, x2 = v[0] - vz * n[0], v[1] - vz * n[1], v[2] - vz * n[2]
    if vx < 1e-4:
        # Viewed along n: any direction across n will do.
        x0, x1, x2 = (0.0, n[2], -n[1]) if abs(n[0]) < 0.7 else (-n[2], 0.0, n[0])
    length = np.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    x0, x1, x2 = x0 / length, x1 / length, x2 / length
    y0, y1, y2 = n[1] * x2 - n[2] * x1, n[2] * x0 - n[0] * x2, n[0] * x1 - n[1] * x0
    return lx * x0 + ly * y0 + lz * n[0], lx * x1 + ly * y1 + lz * n[1], lx * x2 + ly * y2 + lz * n[2], weight


@compiled
def lobe_rays(
    normal: Array, to_viewer: Array, alpha: Array, f0: Array, place: Array, horizon: Array
) -> tuple[Array, Array]:
    """One ``lobe_ray`` per hit, at points (n, 2) of the disc: directions (n, 3), weights (n,).

    Bent normals can send a ray below the surface, of normals ``horizon`` (n, 3); it is mirrored upwards.
    """
    out, weight = np.empty((len(normal), 3)), np.empty(len(normal))
    for i in range(len(normal)):
        x, y, z, weight[i] = lobe_ray(normal[i], to_viewer[i], alpha[i], f0[i], place[i, 0], place[i, 1])
        below = 2.0 * min(x * horizon[i, 0] + y * horizon[i, 1] + z * horizon[i, 2], 0.0)
        out[i, 0] = x - below * horizon[i, 0]
        out[i, 1] = y - below * horizon[i, 1]
        out[i, 2] = z - below * horizon[i, 2]
    return out, weight
