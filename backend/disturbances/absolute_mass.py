"""Mass and inertia in kilograms, where known forces and torques tell them."""

from dataclasses import dataclass, replace

import numpy as np

from polhode.backend.problem.inertia import InertiaForm
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.wrench import LN_MASS, LN_SCALE, Impulses
from polhode.backend.uncertainty.covariance import AxesDerivative, Marginals
from polhode.lie import Array
from polhode.records import MassProperties

MOST_SIGMA = 0.3
"""Of the logarithms: more is called undetermined."""


@dataclass(frozen=True)
class Logarithm:
    """A positive number by its logarithm, and how well that is known."""

    value: float
    sigma: float
    determined: bool


def with_absolute_scale(
    mass: MassProperties,
    iterate: Iterate,
    form: InertiaForm,
    m: Marginals,
    derivative: AxesDerivative,
    known: Impulses | None,
) -> MassProperties:
    """The mass and the middle moment beside what is known up to scale; unchanged without a known wrench."""
    if iterate.wrench is None or m.wrench_information is None or known is None:
        return mass
    scale, kilograms = _logarithms(iterate, form, m, derivative)
    force, torque = (size > 0.0 for size in known.largest)
    detail = {
        **mass.identifiable.detail,
        "mass": _words(kilograms, force, "force"),
        "inertia_scale": _words(scale, torque, "torque"),
    }
    return replace(
        mass,
        mass_kg=float(np.exp(kilograms.value)),
        sigma_mass_kg=_sigma(kilograms),
        inertia_scale_kg_m2=float(np.exp(scale.value)),
        sigma_inertia_scale_kg_m2=_sigma(scale),
        identifiable=replace(mass.identifiable, detail=detail),
    )


def _logarithms(
    iterate: Iterate, form: InertiaForm, m: Marginals, derivative: AxesDerivative
) -> tuple[Logarithm, Logarithm]:
    """Of the middle moment [kg m^2] and of the mass [kg]."""
    assert iterate.wrench is not None and m.wrench_information is not None
    n = iterate.n_states
    at = np.r_[n + 3 : n + 8, n + 8 + LN_SCALE]
    along: Array = np.append(derivative.ln_middle, 1.0)
    middle = float(np.linalg.eigvalsh(iterate.J_G(form))[1])
    # without the prior: what the data alone say of each
    alone = 1.0 / np.sqrt(np.maximum(np.diag(m.wrench_information), 1e-12))
    ln_scale = Logarithm(
        float(iterate.wrench[LN_SCALE] + np.log(middle)),
        float(np.sqrt(along @ m.dense[np.ix_(at, at)] @ along)),
        bool(alone[0] < MOST_SIGMA),
    )
    of_mass = n + 8 + LN_MASS
    sigma = float(np.sqrt(m.dense[of_mass, of_mass]))
    return ln_scale, Logarithm(float(iterate.wrench[LN_MASS]), sigma, bool(alone[1] < MOST_SIGMA))


def _sigma(logarithm: Logarithm) -> float:
    return float(np.exp(logarithm.value) * logarithm.sigma) if logarithm.determined else np.inf


def _words(logarithm: Logarithm, acts: bool, what: str) -> str:
    if logarithm.determined:
        return f"determined, standard deviation about {100.0 * logarithm.sigma:.2g} %"
    if not acts:
        return f"not determined: no known {what} acts"
    return f"not determined: the known {what} moves the target too little beside the disturbances"
