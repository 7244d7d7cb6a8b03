"""The solvers by name (docs/compare.md); each adapter is imported only in the process that runs it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec

from polhode.compare.solver import Claim, Solver
from polhode.config.keys import suggestion
from polhode.runtime.errors import InputError

HOME = "polhode.compare.solvers"


@dataclass(frozen=True)
class Entry:
    """An adapter, described without importing it."""

    name: str
    family: str
    adapter: str
    """MODULE:NAME of a class that is called with the options; the module is in ``HOME`` or has a dot"""
    options: dict[str, str] = field(default_factory=dict)
    claim: Claim = "ok"
    needs: str = ""
    """A package beyond those that polhode always has"""

    def missing(self) -> str | None:
        """The package that it needs, if it is not installed."""
        return self.needs if self.needs and find_spec(self.needs) is None else None

    def load(self) -> Solver:
        """Import the adapter."""
        module, _, name = self.adapter.partition(":")
        make: Callable[..., Solver] = getattr(
            import_module(module if "." in module else f"{HOME}.{module}"), name
        )
        return make(**self.options)


_OURS, _CASADI = "ours:Ours", "casadi_solvers:CasadiSolver"
ENTRIES: tuple[Entry, ...] = (
    Entry("gauss_newton", "ours", _OURS),
    Entry("gauss_newton_ratios", "ours", _OURS, {"form": "ratios_axes"}),
    Entry("ipopt", "ipopt", _CASADI),
    Entry("ipopt_condensed", "ipopt", "condensed:Condensed"),
    Entry("sqp_osqp", "sqp", _CASADI, {"qp": "osqp"}),
    Entry("sqp_ipqp", "sqp", _CASADI, {"qp": "ipqp"}),
    Entry("scipy_trf", "scipy", "scipy_least_squares:TrustRegion"),
    Entry("ceres", "ceres", "ceres:Ceres", needs="pyceres"),
    Entry("gtsam_lm", "gtsam", "gtsam_solvers:Batch", needs="gtsam"),
    Entry("gtsam_isam2", "gtsam", "gtsam_solvers:Incremental", needs="gtsam"),
    Entry("odometry", "baselines", "thesis_methods:Odometry", claim="baseline"),
    Entry("dynamic_isam", "baselines", "thesis_methods:DynamicIsam", claim="baseline"),
    Entry("sqp_qrqp", "sqp", _CASADI, {"qp": "qrqp"}),
)
"""Those that may need all of their time are last."""


def entries(names: tuple[str, ...] = ()) -> tuple[Entry, ...]:
    """The entries named, in that order; without names, all. Raises InputError."""
    if not names:
        return ENTRIES
    known = {entry.name: entry for entry in ENTRIES}
    for name in names:
        if name not in known:
            hint = suggestion(name, list(known))
            raise InputError(f"compare.solvers: unknown solver '{name}';{hint} solvers: {', '.join(known)}")
    return tuple(known[name] for name in names)
