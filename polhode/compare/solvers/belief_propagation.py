"""Gaussian belief propagation, the message passing that thesis 7.2 proposes.

Variables: states, constants, landmarks; factors: the blocks of the common cost. Messages are information
matrix and vector of steps from the current point. In every round all factors send messages, damped; then the
point step to the means of the beliefs, and everything is relinearized.
"""

import numpy as np

from polhode.compare.problem.blocks import Block, Blocks, root_of_kernel
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.geometry.lie import Array

Messages = tuple[Array, Array]
"""Information matrices (n, m, m) and vectors (n, m)."""
KEPT = 0.5
"""Share of the old message in the new one."""
ANCHOR = 1e-3
"""Prior information of every variable, over that of its factors: it keeps the beliefs proper."""
ROUNDS = 20000
TOLERANCE, STATIONARY_ROUNDS = 1e-8, 20
"""Relative change of the cost over so many rounds at which the method ends."""


class BeliefPropagation:
    """Loopy, synchronous."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Rounds until the cost is stationary."""
        blocks = Blocks(problem.data, problem.fixed)
        messages = _Messages(blocks)
        history: list[float] = []
        for count in range(1, ROUNDS + 1):
            with monitor.part("evaluation"), np.errstate(all="ignore"):
                factors = [root_of_kernel(each, problem.data.robust_scale) for each in blocks.all(x)]
                cost = 0.5 * sum(float(np.sum(each.residual**2)) for each in factors)
            monitor.record(cost, x)
            monitor.check()
            if not np.isfinite(cost):
                return AdapterResult(x, False, count, "the messages diverged")
            history.append(cost)
            past = history[-STATIONARY_ROUNDS - 1 :]
            if len(past) > STATIONARY_ROUNDS and abs(past[0] - cost) <= TOLERANCE * cost:
                return AdapterResult(x, True, count, "the cost is stationary")
            x = x + messages.round(factors)
        return AdapterResult(x, False, ROUNDS, "limit of rounds")


class _Messages:
    """Messages from factors to variables: information matrix L and vector e of steps from the point."""

    def __init__(self, blocks: Blocks) -> None:
        self.b, d = blocks, blocks.data
        m, n, s, c = len(d.frame), d.n_frames - 1, blocks.n_state, blocks.n_dense - blocks.n_states
        self.s, self.c = s, c
        self.to_pose, self.to_landmark = _zeros(m, 6), _zeros(m, 3)
        self.to_before, self.to_after, self.to_constants = _zeros(n, s), _zeros(n, s), _zeros(n, c)

    def round(self, factors: list[Block]) -> Array:
        """Update all messages; returns the step (n_x,) to the means of the beliefs."""
        d, s, c = self.b.data, self.s, self.c
        F, n_landmarks = d.n_frames, d.n_landmarks
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
        Lm, em = np.zeros((n_landmarks, 3, 3)), np.zeros((n_landmarks, 3))
        np.add.at(Lm, d.landmark, self.to_landmark[0])
        np.add.at(em, d.landmark, self.to_landmark[1])
        self._anchor(L, Lc, Lm, stereo[0], steps[0])
        self._send_stereo(stereo, L, e, Lm, em)
        self._send_steps(steps, L, e, Lc, ec)
        step = (
            np.asarray(np.linalg.solve(L, e[..., None])[..., 0]),
            np.asarray(np.linalg.solve(Lc, ec)),
            np.asarray(np.linalg.solve(Lm, em[..., None])[..., 0]),
        )
        self._shift(step)
        return np.concatenate([step[0].ravel(), step[1], step[2].ravel()])

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
        """Make the beliefs proper from the first round on."""
        d, s = self.b.data, self.s
        own = np.full((d.n_frames, s), 1e-6)
        np.add.at(own[:, :6], d.frame, np.diagonal(stereo, axis1=1, axis2=2)[:, :6])
        of_steps = np.diagonal(steps, axis1=1, axis2=2)
        own[:-1] += of_steps[:, :s]
        own[1:] += of_steps[:, s : 2 * s]
        L[:, np.arange(s), np.arange(s)] += ANCHOR * own
        Lc[np.diag_indices(self.c)] += ANCHOR * of_steps[:, 2 * s :].sum(axis=0) + 1e-6
        landmarks = np.full((d.n_landmarks, 3), 1e-6)
        np.add.at(landmarks, d.landmark, np.diagonal(stereo, axis1=1, axis2=2)[:, 6:])
        Lm[:, np.arange(3), np.arange(3)] += ANCHOR * landmarks

    def _send_stereo(self, own: Messages, L: Array, e: Array, Lm: Array, em: Array) -> None:
        d = self.b.data
        # marginalize the other components of each state
        fill = np.linalg.solve(L[:, 6:, 6:], np.concatenate([L[:, 6:, :6], e[:, 6:, None]], axis=2))
        Lp = L[:, :6, :6] - L[:, :6, 6:] @ fill[:, :, :6]
        ep = e[:, :6] - (L[:, :6, 6:] @ fill[:, :, 6:])[:, :, 0]
        beliefs = [(Lp[d.frame], ep[d.frame]), (Lm[d.landmark], em[d.landmark])]
        parts = [slice(0, 6), slice(6, 9)]
        self.to_pose, self.to_landmark = _sent(own, parts, beliefs, [self.to_pose, self.to_landmark])

    def _send_steps(self, own: Messages, L: Array, e: Array, Lc: Array, ec: Array) -> None:
        s = self.s
        beliefs = [(L[:-1], e[:-1]), (L[1:], e[1:]), (Lc[None], ec[None])]
        parts = [slice(0, s), slice(s, 2 * s), slice(2 * s, 2 * s + self.c)]
        old = [self.to_before, self.to_after, self.to_constants]
        self.to_before, self.to_after, self.to_constants = _sent(own, parts, beliefs, old)

    def _shift(self, step: tuple[Array, Array, Array]) -> None:
        """Express the messages in steps from the new point."""
        d, (states, constants, landmarks) = self.b.data, step
        for message, part in (
            (self.to_pose, states[d.frame, :6]),
            (self.to_landmark, landmarks[d.landmark]),
            (self.to_before, states[:-1]),
            (self.to_after, states[1:]),
            (self.to_constants, np.broadcast_to(constants, (d.n_frames - 1, self.c))),
        ):
            message[1][:] -= (message[0] @ part[:, :, None])[:, :, 0]


def _zeros(n: int, width: int) -> Messages:
    return np.zeros((n, width, width)), np.zeros((n, width))


def _normal(block: Block) -> Messages:
    """Information of each factor in its own unknowns."""
    Jt = np.swapaxes(block.jacobian, 1, 2)
    return Jt @ block.jacobian, -(Jt @ block.residual[:, :, None])[:, :, 0]


def _sent(own: Messages, parts: list[slice], beliefs: list[Messages], old: list[Messages]) -> list[Messages]:
    """Messages of factors to each part of their unknowns: the other parts, with their cavities, marginalized.

    The cavity of a part is its belief without the factor's old message.
    """
    cavities = [(L - message[0], e - message[1]) for (L, e), message in zip(beliefs, old, strict=True)]
    joint, vector = own[0].copy(), own[1].copy()
    for part, cavity in zip(parts, cavities, strict=True):
        joint[:, part, part] += cavity[0]
        vector[:, part] += cavity[1]
    new = []
    for part, cavity, message in zip(parts, cavities, old, strict=True):
        index = np.arange(part.start, part.stop)
        others = np.setdiff1d(np.arange(joint.shape[1]), index)[:, None]
        A, B = joint[:, others, others.T], joint[:, others, index]
        fill = np.linalg.solve(A, np.concatenate([B, vector[:, others]], axis=2))
        Bt = np.swapaxes(B, 1, 2)
        L = joint[:, part, part] - Bt @ fill[:, :, : len(index)] - cavity[0]
        e = vector[:, part] - (Bt @ fill[:, :, len(index) :])[:, :, 0] - cavity[1]
        new.append(_damped(message, (L, e)))
    return new


def _damped(old: Messages, new: Messages) -> Messages:
    return KEPT * old[0] + (1.0 - KEPT) * new[0], KEPT * old[1] + (1.0 - KEPT) * new[1]
