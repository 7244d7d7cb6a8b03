"""Explanations of the symbols and terms of the report, shown where they occur."""

import re
from typing import NamedTuple


class Term(NamedTuple):
    """A symbol or a word, and what it means in a sentence."""

    name: str
    pattern: str
    """regular expression of its occurrences in a text without markup"""
    meaning: str


TERMS: tuple[Term, ...] = (
    Term(
        *("N", r"\bN\b(?!\s*m\b)|q_?NP|\b[rv][xyz]\b"),
        "the inertial frame: the left camera at the first frame, unless the data give the inspector's poses",
    ),
    Term(
        *("G", r"\bG\b|com_G|R_GP"),
        "the geometric frame, fixed to the target; landmarks and mesh are given in it. Its origin and axes "
        "have no physical meaning: they are those of the first frame",
    ),
    Term(
        *("P", r"\bP\b|q_?NP|\bprincipal ax[ei]s\b|ω[xyz]"),
        "the frame of the principal axes: its origin is the centre of mass, x is the axis of the largest, z "
        "that of the smallest moment of inertia",
    ),
    Term("k1", r"\bk_?1\b", "ln(Jxx / Jyy), the largest over the middle moment; 0: the two are equal"),
    Term("k2", r"\bk_?2\b", "ln(Jyy / Jzz), the middle over the smallest moment; 0: the two are equal"),
    Term(
        *("Jxx, Jyy, Jzz", r"\bJ(xx|yy|zz)\b"),
        "the principal moments of inertia, sorted from the largest to the smallest; cameras determine only "
        "their ratios, and Jyy is set to 1",
    ),
    Term(
        *("σ", r"σ|\bsigma"),
        "standard deviation; if the estimate is right, an error lies within ± 3σ in 997 of 1000 cases",
    ),
    Term("ω", r"ω", "angular velocity of the target relative to N, along P"),
    Term("RMSE", r"\bRMSE\b", "root mean square of the error over all frames"),
    Term(
        *("NEES", r"\bNEES\b"),
        "normalised estimation error squared: the error over its own covariance. It should be about the "
        "number of components; more means that the stated σ are too small, less that they are cautious",
    ),
    Term("accuracy", r"\baccuracy\b", "mean distance from points of the estimated surface to the true one"),
    Term(
        *("completion", r"\bcompletion\b"),
        "mean distance from points of the true surface, of those that were seen and lit, to the estimate",
    ),
    Term("chamfer", r"\bchamfer\b", "mean of accuracy and completion"),
    Term(
        *("Hausdorff 95", r"\bhausdorff95\b"),
        "the distance that 95 % of the points of either surface keep from the other",
    ),
    Term(
        *("completeness 3mm", r"\bcompleteness 3mm\b"),
        "share of the true surface that was seen and lit and lies within 3 mm of the estimate",
    ),
    Term(
        *("reduced chi-squared", r"\b[Rr]educed chi-squared\b"),
        "mean square of the residuals over their stated noise; about 1 if the noise is stated rightly",
    ),
    Term(
        *("disparity", r"\bdisparity\b"),
        "column in the left image minus column in the right one: inversely proportional to the distance",
    ),
    Term("u, v", r"\bu, v\b|\| u \| v\b", "column and row in the left image"),
    Term(
        *("robust kernel", r"\brobust kernel\b"),
        "a cost that grows more slowly than the square, so that outliers have little influence",
    ),
    Term(
        *("causal estimate", r"\bcausal\b"),
        "what was known when a frame came, from the frames up to it alone",
    ),
    Term(
        *("polhode", r"\bpolhode\b"),
        "the path of the angular velocity in the principal axes; closed for a free rigid body",
    ),
    Term("com", r"\bcom\b|\bcom_", "centre of mass"),
    Term("IPOPT", r"\bIPOPT\b|\bipopt\b", "the interior-point solver that finds the final estimate"),
)


def find_terms(text: str) -> list[Term]:
    """The terms that occur in a text, in the order of ``TERMS``."""
    return [term for term in TERMS if re.search(term.pattern, text)]
