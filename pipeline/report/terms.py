"""Explanations of the symbols and terms of the report, shown where they occur."""

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Term:
    """A symbol or a word, and what it means in a sentence."""

    name: str
    meaning: str
    pattern: str
    """regular expression of its occurrences in a text without markup"""


TERMS: tuple[Term, ...] = (
    Term(
        "N",
        "the inertial frame: the left camera at the first frame, unless the data give the inspector's poses",
        r"\bN\b(?!\s*m\b)|q_?NP|\b[rv][xyz]\b",
    ),
    Term(
        "G",
        "the geometric frame, fixed to the target; landmarks and mesh are given in it. Its origin and axes "
        "have no physical meaning: they are those of the first frame",
        r"\bG\b|com_G|R_GP",
    ),
    Term(
        "P",
        "the frame of the principal axes: its origin is the centre of mass, x is the axis of the largest, z "
        "that of the smallest moment of inertia",
        r"\bP\b|q_?NP|\bprincipal ax[ei]s\b|ω[xyz]",
    ),
    Term("k1", "ln(Jxx / Jyy), the largest over the middle moment; 0: the two are equal", r"\bk_?1\b"),
    Term("k2", "ln(Jyy / Jzz), the middle over the smallest moment; 0: the two are equal", r"\bk_?2\b"),
    Term(
        "Jxx, Jyy, Jzz",
        "the principal moments of inertia, sorted from the largest to the smallest; cameras determine only "
        "their ratios, and Jyy is set to 1",
        r"\bJ(xx|yy|zz)\b",
    ),
    Term(
        "σ",
        "standard deviation; if the estimate is right, an error lies within ± 3σ in 997 of 1000 cases",
        r"σ|\bsigma",
    ),
    Term("ω", "angular velocity of the target relative to N, along P", r"ω"),
    Term("RMSE", "root mean square of the error over all frames", r"\bRMSE\b"),
    Term(
        "NEES",
        "normalised estimation error squared: the error over its own covariance. It should be about the "
        "number of components; more means that the stated σ are too small, less that they are cautious",
        r"\bNEES\b",
    ),
    Term(
        "accuracy",
        "mean distance from points of the estimated surface to the true one",
        r"\baccuracy\b",
    ),
    Term(
        "completion",
        "mean distance from points of the true surface, of those that were seen and lit, to the estimate",
        r"\bcompletion\b",
    ),
    Term("chamfer", "mean of accuracy and completion", r"\bchamfer\b"),
    Term(
        "Hausdorff 95",
        "the distance that 95 % of the points of either surface keep from the other",
        r"\bhausdorff95\b",
    ),
    Term(
        "completeness 3mm",
        "share of the true surface that was seen and lit and lies within 3 mm of the estimate",
        r"\bcompleteness 3mm\b",
    ),
    Term(
        "reduced chi-squared",
        "mean square of the residuals over their stated noise; about 1 if the noise is stated rightly",
        r"\b[Rr]educed chi-squared\b",
    ),
    Term(
        "disparity",
        "column in the left image minus column in the right one: inversely proportional to the distance",
        r"\bdisparity\b",
    ),
    Term("u, v", "column and row in the left image", r"\bu, v\b|\| u \| v\b"),
    Term(
        "robust kernel",
        "a cost that grows more slowly than the square, so that outliers have little influence",
        r"\brobust kernel\b",
    ),
    Term(
        "causal estimate",
        "what was known when a frame came, from the frames up to it alone",
        r"\bcausal\b",
    ),
    Term(
        "polhode",
        "the path of the angular velocity in the principal axes; closed for a free rigid body",
        r"\bpolhode\b",
    ),
    Term("com", "centre of mass", r"\bcom\b|\bcom_"),
    Term(
        "IPOPT",
        "the interior-point solver that finds the final estimate",
        r"\bIPOPT\b|\bipopt\b",
    ),
)


def explained(text: str) -> list[Term]:
    """The terms that occur in a text, in the order of ``TERMS``."""
    return [term for term in TERMS if re.search(term.pattern, text)]
