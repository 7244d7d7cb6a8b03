"""The solvers by name. Each adapter is imported when its turn comes, in its own process."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec

from pipeline.compare.solver import Claim, Solver
from polhode.config.keys import suggestion
from polhode.errors import InputError

HOME = "pipeline.compare.solvers"


@dataclass(frozen=True)
class Entry:
    """Where an adapter is, and what is known of it without importing it."""

    name: str
    family: str
    claim: Claim
    words: str
    module: str
    make: str
    """Name of a class or function of the module; called with ``options``"""
    options: tuple[tuple[str, str], ...] = ()
    needs: tuple[str, ...] = ()
    """Packages beyond those that polhode always has"""

    def missing(self) -> str | None:
        """The first package that it needs and that is not installed."""
        return next((package for package in self.needs if find_spec(package) is None), None)

    def load(self) -> Solver:
        """Import the adapter."""
        module = self.module if "." in self.module else f"{HOME}.{self.module}"
        make: Callable[..., Solver] = getattr(import_module(module), self.make)
        return make(**dict(self.options))


def _entry(
    name: str, family: str, claim: Claim, words: str, where: str, needs: tuple[str, ...] = (), **options: str
) -> Entry:
    module, _, make = where.partition(":")
    return Entry(name, family, claim, words, module, make, tuple(options.items()), needs)


ENTRIES: tuple[Entry, ...] = (
    _entry(
        "gauss_newton", "ours", "ok", "Gauss-Newton/Levenberg, landmarks and chain eliminated", "ours:Ours"
    ),
    _entry(
        "gauss_newton_ratios",
        "ours",
        "ok",
        "the same, inertia as ratios and axes",
        "ours:Ours",
        form="ratios_axes",
    ),
    _entry(
        "scipy_trf",
        "scipy",
        "ok",
        "least_squares, trust region, sparse Jacobian, LSMR",
        "scipy_least_squares:TrustRegion",
    ),
    _entry(
        "ceres", "ceres", "ok", "Levenberg-Marquardt, sparse Schur complement", "ceres:Ceres", ("pyceres",)
    ),
)
DEFAULT = "gauss_newton"


def entries(names: tuple[str, ...] = ()) -> tuple[Entry, ...]:
    """Those named, in that order; all of them without a name. Raises InputError for an unknown one."""
    if not names:
        return ENTRIES
    known = {entry.name: entry for entry in ENTRIES}
    for name in names:
        if name not in known:
            hint = suggestion(name, list(known))
            raise InputError(f"compare.solvers: unknown solver '{name}';{hint} solvers: {', '.join(known)}")
    return tuple(known[name] for name in names)
