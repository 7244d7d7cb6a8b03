"""Gaussian belief propagation: the message passing that thesis 7.2 proposes, to show where it stands.

Variables: states, constants, landmarks; factors: the blocks of the common cost. Messages are information and
its vector over steps from the current point; every round all factors speak at once, damped, then the point
moves to the beliefs' means and everything is linearised again.
"""

import numpy as np

from polhode.compare.problem.blocks import Block, Blocks, root_of_kernel
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import Outcome, SolveMonitor
from polhode.lie import Array

KEPT = 0.5
"""Share of the old message in the new one."""
ANCHOR = 1e-3
"""Information that keeps every variable at its place, over that of its own factors: beliefs stay proper."""
ROUNDS = 20000
TOLERANCE, RESTING = 1e-8, 20
"""Relative decrease of the cost over so many rounds that ends them."""


class BeliefPropagation:
    """Loopy, synchronous."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> Outcome:
        """Rounds until the cost rests."""
        blocks = Blocks(problem.data, problem.held)
        passing, best = _Messages(blocks), np.inf
        history: list[float] = []
        for count in range(1, ROUNDS + 1):
            with monitor.part("evaluation"), np.errstate(all="ignore"):
                factors = [root_of_kernel(each, problem.data.robust_scale) for each in blocks.all(x)]
                cost = 0.5 * sum(float(np.sum(each.residual**2)) for each in factors)
            monitor.note(cost, x)
            monitor.check()
            if not np.isfinite(cost):
                return Outcome(x, False, count, "the messages diverged")
            history.append(cost)
            best = min(best, cost)
            if len(history) > RESTING and abs(history[-RESTING - 1] - cost) <= TOLERANCE * cost:
                return Outcome(x, True, count, "the cost rests")
            x = x + passing.round(factors)
        return Outcome(x, False, ROUNDS, "limit of rounds")


class _Messages:
    """Messages from factors to variables, as information L and vector e about steps from the point."""

    def __init__(self, blocks: Blocks) -> None:
        self.b, d = blocks, blocks.data
        m, n, s, c = len(d.frame), d.n_frames - 1, blocks.n_state, blocks.n_dense - blocks.n_states
        self.s, self.c = s, c
        self.to_pose, self.to_mark = _none(m, 6), _none(m, 3)
        self.to_before, self.to_after, self.to_constants = _none(n, s), _none(n, s), _none(n, c)

    def round(self, factors: list[Block]) -> Array:
        """All messages anew; the step (n_x,) to the beliefs' means."""
        d, s, c = self.b.data, self.s, self.c
        F, n_marks = d.n_frames, d.n_landmarks
        stereo, steps = (_normal(each) for each in factors[:2])
        L, e = np.zeros((F, s, s)), np.zeros((F, s))
        Lc, ec = np.zeros((c, c)), np.zeros(c)
        for other in factors[2:]:
            self._add_others(other, L, e, Lc, ec)
        np.add.at(L[:, :6, :6], d.frame, self.to_pose[0])
        np.add.at(e[:, :6], d.frame, self.to_pose[1])
        for at, message in ((slice(0, F - 1), self.to_before), (slice(1, F), self.to_after)):
            L[at] += message[0]
            e[at] += message[1]
        Lc, ec = Lc + self.to_constants[0].sum(axis=0), ec + self.to_constants[1].sum(axis=0)
        Lm, em = np.zeros((n_marks, 3, 3)), np.zeros((n_marks, 3))
        np.add.at(Lm, d.landmark, self.to_mark[0])
        np.add.at(em, d.landmark, self.to_mark[1])
        self._anchor(L, Lc, Lm, stereo[0], steps[0])
        self._speak_stereo(stereo, L, e, Lm, em)
        self._speak_steps(steps, L, e, Lc, ec)
        moves = (
            np.asarray(np.linalg.solve(L, e[..., None])[..., 0]),
            np.asarray(np.linalg.solve(Lc, ec)),
            np.asarray(np.linalg.solve(Lm, em[..., None])[..., 0]),
        )
        self._shift(moves)
        return np.concatenate([moves[0].ravel(), moves[1], moves[2].ravel()])

    def _add_others(self, block: Block, L: Array, e: Array, Lc: Array, ec: Array) -> None:
        H, g = _normal(block)
        for row, slots in enumerate(block.slots):
            if slots[0] >= self.b.n_states:
                at = slots - self.b.n_states
                Lc[np.ix_(at, at)] += H[row]
                ec[at] += g[row]
            else:
                k, at = slots[0] // self.s, slots % self.s
                L[k][np.ix_(at, at)] += H[row]
                e[k][at] += g[row]

    def _anchor(self, L: Array, Lc: Array, Lm: Array, stereo: Array, steps: Array) -> None:
        """Beliefs are proper from the first round on."""
        d, s = self.b.data, self.s
        own = np.full((d.n_frames, s), 1e-6)
        np.add.at(own[:, :6], d.frame, np.diagonal(stereo, axis1=1, axis2=2)[:, :6])
        of_steps = np.diagonal(steps, axis1=1, axis2=2)
        own[:-1] += of_steps[:, :s]
        own[1:] += of_steps[:, s : 2 * s]
        L[:, np.arange(s), np.arange(s)] += ANCHOR * own
        Lc[np.diag_indices(self.c)] += ANCHOR * of_steps[:, 2 * s :].sum(axis=0) + 1e-6
        marks = np.full((d.n_landmarks, 3), 1e-6)
        np.add.at(marks, d.landmark, np.diagonal(stereo, axis1=1, axis2=2)[:, 6:])
        Lm[:, np.arange(3), np.arange(3)] += ANCHOR * marks

    def _speak_stereo(self, own: tuple[Array, Array], L: Array, e: Array, Lm: Array, em: Array) -> None:
        d, (H, g) = self.b.data, own
        # what the rest of a state says of its pose
        fill = np.linalg.solve(L[:, 6:, 6:], np.concatenate([L[:, 6:, :6], e[:, 6:, None]], axis=2))
        Lp = L[:, :6, :6] - L[:, :6, 6:] @ fill[:, :, :6]
        ep = e[:, :6] - (L[:, :6, 6:] @ fill[:, :, 6:])[:, :, 0]
        pose = Lp[d.frame] - self.to_pose[0], ep[d.frame] - self.to_pose[1]
        mark = Lm[d.landmark] - self.to_mark[0], em[d.landmark] - self.to_mark[1]
        to_mark = _eliminated(H, g, slice(0, 6), slice(6, 9), pose)
        to_pose = _eliminated(H, g, slice(6, 9), slice(0, 6), mark)
        self.to_mark, self.to_pose = _damped(self.to_mark, to_mark), _damped(self.to_pose, to_pose)

    def _speak_steps(self, own: tuple[Array, Array], L: Array, e: Array, Lc: Array, ec: Array) -> None:
        (H, g), s = own, self.s
        parts = [slice(0, s), slice(s, 2 * s), slice(2 * s, 2 * s + self.c)]
        old = [self.to_before, self.to_after, self.to_constants]
        beliefs = [(L[:-1], e[:-1]), (L[1:], e[1:]), (Lc[None], ec[None])]
        joint, vector = H.copy(), g.copy()
        for part, belief, message in zip(parts, beliefs, old, strict=True):
            joint[:, part, part] += belief[0] - message[0]
            vector[:, part] += belief[1] - message[1]
        new = []
        for part, belief, message in zip(parts, beliefs, old, strict=True):
            rest = np.setdiff1d(np.arange(2 * s + self.c), np.arange(part.start, part.stop))
            A, B = joint[:, rest[:, None], rest], joint[:, rest[:, None], np.arange(part.start, part.stop)]
            fill = np.linalg.solve(A, np.concatenate([B, vector[:, rest, None]], axis=2))
            Bt = np.swapaxes(B, 1, 2)
            width = part.stop - part.start
            info = joint[:, part, part] - Bt @ fill[:, :, :width] - (belief[0] - message[0])
            mean = vector[:, part] - (Bt @ fill[:, :, width:])[:, :, 0] - (belief[1] - message[1])
            new.append(_damped(message, (info, mean)))
        self.to_before, self.to_after, self.to_constants = new

    def _shift(self, moves: tuple[Array, Array, Array]) -> None:
        """Messages about steps from the new point."""
        d, (states, constants, marks) = self.b.data, moves
        for message, move in (
            (self.to_pose, states[d.frame, :6]),
            (self.to_mark, marks[d.landmark]),
            (self.to_before, states[:-1]),
            (self.to_after, states[1:]),
            (self.to_constants, np.broadcast_to(constants, (d.n_frames - 1, self.c))),
        ):
            message[1][:] -= (message[0] @ move[:, :, None])[:, :, 0]


def _none(n: int, width: int) -> tuple[Array, Array]:
    return np.zeros((n, width, width)), np.zeros((n, width))


def _normal(block: Block) -> tuple[Array, Array]:
    """Information of each factor in its own unknowns, and its vector."""
    Jt = np.swapaxes(block.jacobian, 1, 2)
    return Jt @ block.jacobian, -(Jt @ block.residual[:, :, None])[:, :, 0]


def _eliminated(
    H: Array, g: Array, out: slice, kept: slice, cavity: tuple[Array, Array]
) -> tuple[Array, Array]:
    """What a factor says of ``kept`` when ``out`` is only known by its cavity."""
    A, B = H[:, out, out] + cavity[0], H[:, out, kept]
    fill = np.linalg.solve(A, np.concatenate([B, (g[:, out] + cavity[1])[:, :, None]], axis=2))
    Bt, width = np.swapaxes(B, 1, 2), kept.stop - kept.start
    return H[:, kept, kept] - Bt @ fill[:, :, :width], g[:, kept] - (Bt @ fill[:, :, width:])[:, :, 0]


def _damped(old: tuple[Array, Array], new: tuple[Array, Array]) -> tuple[Array, Array]:
    return KEPT * old[0] + (1.0 - KEPT) * new[0], KEPT * old[1] + (1.0 - KEPT) * new[1]
