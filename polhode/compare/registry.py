"""The solvers by name. Each adapter is imported only in the process that runs it."""

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
    description: str
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


_VARIANT, _SQP = "casadi_solvers:Variant", "casadi_solvers:Sqp"
_EXACT, _SLACK = {"hessian": "exact"}, {"dynamics": "slack", "code": "c"}

ENTRIES: tuple[Entry, ...] = (
    Entry("gauss_newton", "ours", "ours:Ours", "Gauss-Newton/Levenberg, landmarks eliminated"),
    Entry(
        "gauss_newton_ratios", "ours", "ours:Ours", "the same, inertia as ratios and axes",
        {"form": "ratios_axes"},
    ),
    Entry("ipopt", "ipopt", "casadi_solvers:Shipped", "IPOPT as polhode runs it: stereo in compiled loops"),
    Entry("ipopt_condensed", "ipopt", "condensed:Condensed", "IPOPT, landmarks condensed"),
    Entry("ipopt_vm", "ipopt", _VARIANT, "Gauss-Newton Hessian, virtual machine"),
    Entry("ipopt_c", "ipopt", _VARIANT, "Gauss-Newton Hessian, generated C", {"code": "c"}),
    Entry("ipopt_exact_vm", "ipopt", _VARIANT, "exact Hessian, virtual machine", _EXACT),
    Entry("ipopt_exact_c", "ipopt", _VARIANT, "exact Hessian, generated C", {**_EXACT, "code": "c"}),
    Entry(
        "ipopt_slack", "ipopt", _VARIANT, "dynamics as equalities with slack, Gauss-Newton Hessian", _SLACK
    ),
    Entry(
        "ipopt_slack_exact", "ipopt", _VARIANT, "dynamics as equalities with slack, exact Hessian",
        {**_EXACT, **_SLACK},
    ),
    Entry("sqp_osqp", "sqp", _SQP, "CasADi sqpmethod, OSQP", {"qp": "osqp"}),
    Entry("sqp_ipqp", "sqp", _SQP, "CasADi sqpmethod, its interior-point QP", {"qp": "ipqp"}),
    Entry(
        "scipy_trf", "scipy", "scipy_least_squares:TrustRegion", "least_squares, sparse Jacobian, LSMR"
    ),
    Entry("ceres", "ceres", "ceres:Ceres", "Levenberg-Marquardt, sparse Schur complement", needs="pyceres"),
    Entry(
        "gtsam_lm", "gtsam", "gtsam_solvers:Batch", "Levenberg-Marquardt, own stereo factors", needs="gtsam"
    ),
    Entry("gtsam_isam2", "gtsam", "gtsam_solvers:Incremental", "iSAM2 frame by frame", needs="gtsam"),
    Entry(
        "odometry", "baselines", "thesis_methods:Odometry", "no dynamics in the map (thesis 7.2)",
        claim="baseline",
    ),
    Entry(
        "dynamic_isam", "baselines", "thesis_methods:DynamicIsam", "the method of the thesis",
        claim="baseline",
    ),
    Entry(
        "belief_propagation", "baselines", "belief_propagation:BeliefPropagation",
        "Gaussian belief propagation (thesis 7.2)",
    ),
    Entry("sqp_qrqp", "sqp", _SQP, "CasADi sqpmethod, its sparse QR active set", {"qp": "qrqp"}),
)  # fmt: skip
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
