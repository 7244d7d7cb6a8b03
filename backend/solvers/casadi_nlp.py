"""Nonlinear programs in CasADi: assembly from blocks, functions from outside, and the set-up of IPOPT.

A program is assembled from the cost, gradient and Hessian blocks of many kernels: ``gather`` reads their
unknowns from the program's vector, constant sparse matrices (``scatter``) add up their blocks.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from polhode.geometry.lie import Array, Ints

OPTIMAL = ("Solve_Succeeded", "Solved_To_Acceptable_Level", "Search_Direction_Becomes_Too_Small")
"""Return statuses of IPOPT that count as an optimum."""


class ExternalFunction(ca.Callback):
    """A NumPy function of vectors, with one vector as its result, that CasADi can call.

    CasADi holds only a weak reference: the object must live as long as the programs that call it.
    """

    def __init__(
        self, name: str, function: Callable[..., Array | float], sizes: tuple[int, ...], n_out: int
    ) -> None:
        ca.Callback.__init__(self)
        self._function, self._sizes, self._n_out = function, sizes, n_out
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._sizes)

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, index: int) -> Any:
        return ca.Sparsity.dense(self._sizes[index], 1)

    def get_sparsity_out(self, _: int) -> Any:
        return ca.Sparsity.dense(self._n_out, 1)

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: Any, results: Any) -> int:
        """Evaluate the function in place; 0 means success."""
        vectors = [np.array(np.frombuffer(argument, dtype=np.float64)) for argument in arguments]
        np.frombuffer(results[0], dtype=np.float64)[:] = self._function(*vectors)
        return 0


def ipopt_solver(
    name: str, options: dict[str, Any], x: Any, p: Any, cost: Any, gradient: Any, hessian: tuple[Any, Any]
) -> Any:
    """IPOPT on a program, minimize ``cost`` over x with parameters p.

    hessian: the sparsity of its upper triangle and the values of these entries.
    """
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", 0)
    names, inputs = ["x", "p", "lam_f", "lam_g"], [x, p, lam_f, lam_g]
    upper = ca.MX(hessian[0], lam_f * hessian[1])
    derivatives = {
        "grad_f": ca.Function("nlp_grad_f", [x, p], [cost, gradient], ["x", "p"], ["f", "grad_f_x"]),
        "hess_lag": ca.Function("nlp_hess_l", inputs, [upper], names, ["triu_hess_gamma_x_x"]),
    }
    return ca.nlpsol(name, "ipopt", {"x": x, "p": p, "f": cost}, {**options, **derivatives})


def ipopt_options(
    tolerance: float, stationary_cost_change: float, max_iterations: int, **more: Any
) -> dict[str, Any]:
    """Options of CasADi and IPOPT, apart from the derivatives.

    The iterations end at a gradient below the tolerance, or when the relative change of the cost stays below
    ``stationary_cost_change`` three times in a row: in the flat valley of a quantity that the motion does not
    determine, gradients stay large while the cost no longer changes. ``more`` are further options of IPOPT.
    """
    return {
        "no_nlp_grad": True,
        "calc_lam_p": False,
        "print_time": False,
        # CasADi writes them to standard error, which holds one line; a solution that is NaN is refused.
        "show_eval_warnings": False,
        "error_on_fail": False,
        "ipopt": {
            # else IPOPT reads ipopt.opt of the current folder, which may be another person's: it can name
            # files to write and libraries to load
            "option_file_name": "",
            "print_level": 0,
            "sb": "yes",
            "linear_solver": "mumps",
            "max_iter": max_iterations,
            "tol": tolerance,
            "dual_inf_tol": tolerance,
            "acceptable_tol": 1e8,
            "acceptable_iter": 3,
            "acceptable_obj_change_tol": stationary_cost_change,
            "nlp_scaling_method": "none",
            **more,
        },
    }


def gather(vector: Any, slots: Ints) -> Any:
    """Matrix (width, n) whose columns are the entries ``slots`` (n, width) of a vector."""
    return ca.reshape(vector[slots.ravel().tolist()], slots.shape[1], slots.shape[0])


def scatter(target: Ints, size: int) -> Any:
    """Constant matrix (size, n) that adds entry e of a vector to ``target[e]``."""
    n = len(target)
    return ca.DM(ca.Sparsity(size, n, list(range(n + 1)), target.tolist()), np.ones(n))


def upper_keys(slots: Ints, n_x: int) -> Ints:
    """Cells ``column * n_x + row`` of the upper triangle of the block on each row of slots (n, width)."""
    width = slots.shape[1]
    cols, rows = np.tril_indices(width)
    return np.asarray(slots[:, cols] * n_x + slots[:, rows]).ravel()


def upper_sparsity(cells: Ints, n_x: int) -> Any:
    """Sparsity of the upper triangle of a matrix (n_x, n_x) with these cells, sorted."""
    columns, rows = np.divmod(cells, n_x)
    offsets = np.searchsorted(columns, np.arange(n_x + 1))
    return ca.Sparsity(n_x, n_x, offsets.tolist(), rows.tolist())
