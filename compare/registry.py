"""The solvers by name. Each adapter is imported when its turn comes, in its own process."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec

from polhode.compare.solver import Claim, Solver
from polhode.config.keys import suggestion
from polhode.errors import InputError

HOME = "polhode.compare.solvers"


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
    _entry("gauss_newton", "ours", "ok", "Gauss-Newton/Levenberg, landmarks eliminated", "ours:Ours"),
    _entry(
        "gauss_newton_ratios",
        "ours",
        "ok",
        "the same, inertia as ratios and axes",
        "ours:Ours",
        form="ratios_axes",
    ),
    _entry("ipopt", "ipopt", "ok", "IPOPT as polhode runs it: stereo in compiled loops", "ipopt:Shipped"),
    _entry("ipopt_condensed", "ipopt", "ok", "IPOPT, landmarks condensed", "condensed:Condensed"),
    _entry("ipopt_vm", "ipopt", "ok", "Gauss-Newton Hessian, virtual machine", "ipopt:Variant"),
    _entry("ipopt_c", "ipopt", "ok", "Gauss-Newton Hessian, generated C", "ipopt:Variant", code="c"),
    _entry(
        "ipopt_exact_vm", "ipopt", "ok", "exact Hessian, virtual machine", "ipopt:Variant", hessian="exact"
    ),
    _entry(
        "ipopt_exact_c",
        "ipopt",
        "ok",
        "exact Hessian, generated C",
        "ipopt:Variant",
        hessian="exact",
        code="c",
    ),
    _entry(
        "ipopt_slack",
        "ipopt",
        "ok",
        "dynamics as equalities with slack, Gauss-Newton Hessian",
        "ipopt:Variant",
        dynamics="slack",
        code="c",
    ),
    _entry(
        "ipopt_slack_exact",
        "ipopt",
        "ok",
        "dynamics as equalities with slack, exact Hessian",
        "ipopt:Variant",
        hessian="exact",
        dynamics="slack",
        code="c",
    ),
    _entry("sqp_osqp", "sqp", "ok", "CasADi sqpmethod, OSQP", "sqp:Sqp", qp="osqp"),
    _entry("sqp_ipqp", "sqp", "ok", "CasADi sqpmethod, its interior-point QP", "sqp:Sqp", qp="ipqp"),
    _entry(
        "scipy_trf", "scipy", "ok", "least_squares, sparse Jacobian, LSMR", "scipy_least_squares:TrustRegion"
    ),
    _entry(
        "ceres", "ceres", "ok", "Levenberg-Marquardt, sparse Schur complement", "ceres:Ceres", ("pyceres",)
    ),
    _entry(
        "gtsam_lm",
        "gtsam",
        "ok",
        "Levenberg-Marquardt, own stereo factors",
        "gtsam_solvers:Batch",
        ("gtsam",),
    ),
    _entry("gtsam_isam2", "gtsam", "ok", "iSAM2 frame by frame", "gtsam_solvers:Incremental", ("gtsam",)),
    _entry("odometry", "baselines", "baseline", "no dynamics in the map (thesis 7.2)", "odometry:Odometry"),
    _entry("dynamic_isam", "baselines", "baseline", "the thesis's own way", "dynamic_isam:DynamicIsam"),
    _entry(
        "belief_propagation",
        "baselines",
        "ok",
        "Gaussian belief propagation (thesis 7.2)",
        "belief_propagation:BeliefPropagation",
    ),
    _entry("sqp_qrqp", "sqp", "ok", "CasADi sqpmethod, its sparse QR active set", "sqp:Sqp", qp="qrqp"),
)
"""Those that may need all of their time stand last."""
ABLATIONS: tuple[Entry, ...] = (
    _entry(
        "ablation_log_ratios",
        "ablations",
        "baseline",
        "inertia as k1, k2 and axes",
        "ablations:Ablation",
        variant="log_ratios",
    ),
    _entry(
        "ablation_constant_noise",
        "ablations",
        "baseline",
        "process noise of a body at rest",
        "ablations:Ablation",
        variant="constant_noise",
    ),
    _entry(
        "ablation_open_loop",
        "ablations",
        "baseline",
        "no loop closure",
        "ablations:Ablation",
        variant="open_loop",
    ),
    _entry(
        "unknowns_rotation_vector",
        "ablations",
        "ok",
        "sparse LM, attitude as rotation vector",
        "changed_unknowns:ChangedUnknowns",
    ),
    _entry(
        "unknowns_mrp",
        "ablations",
        "ok",
        "sparse LM, attitude as MRP",
        "changed_unknowns:ChangedUnknowns",
        unknowns="mrp",
    ),
    _entry(
        "unknowns_body",
        "ablations",
        "ok",
        "sparse LM, features from the centre of mass",
        "changed_unknowns:ChangedUnknowns",
        unknowns="body",
    ),
    *(
        _entry(
            f"unknowns_{kind}",
            "ablations",
            "baseline" if kind == "aghili_free" else "ok",
            words,
            "changed_unknowns:ChangedUnknowns",
            unknowns=kind,
        )
        for kind, words in (
            ("log_ratios", "sparse LM, inertia as k1, k2 and axes"),
            ("aghili", "sparse LM, inertia as Aghili's three and axes"),
            ("aghili_held", "the same, their dependence held"),
            ("aghili_free", "the same, free in the dynamics"),
            ("lichter", "sparse LM, inertia as Lichter's quaternion and axes"),
        )
    ),
    *(
        _entry(
            f"window_{frames}",
            "ablations",
            "baseline",
            f"sliding window of {frames} frames",
            "sliding_window:WindowLength",
            frames=frames,
        )
        for frames in ("6", "12", "24", "48")
    ),
)
"""Variants of the formulation: only those that are named are run."""


def entries(names: tuple[str, ...] = ()) -> tuple[Entry, ...]:
    """Those named, in that order; all of them without a name. Raises InputError for an unknown one."""
    if not names:
        return ENTRIES
    known = {entry.name: entry for entry in (*ENTRIES, *ABLATIONS)}
    for name in names:
        if name not in known:
            hint = suggestion(name, list(known))
            raise InputError(f"compare.solvers: unknown solver '{name}';{hint} solvers: {', '.join(known)}")
    return tuple(known[name] for name in names)
