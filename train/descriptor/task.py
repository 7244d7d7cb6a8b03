"""The descriptor network as a task of the training loop, and its loss.

The loss: contrast, reliability, direction, and end to end the matches and the motion.

Contrast is InfoNCE (van den Oord et al., "Representation learning with contrastive predictive coding", 2018)
in both directions. In addition each frame pair of a batch is matched by the dual softmax of
``frontend.matching.matchers``: true pairs should be probable, distractors should be assigned to the dustbin,
and the motion that is fitted to the matches should be the true one. The gradient passes from the motion
through the fit and the matches to the network.
"""

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from polhode.config.train_settings import Train
from polhode.frontend.matching.matchers import EXCLUDED_SCORE, DualSoftmax, rigid_fit
from polhode.frontend.networks.descriptor import DescriptorNet, DescriptorOutput
from polhode.frontend.networks.grouping import Grouping
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress
from polhode.train.corpus import render_corpus, split
from polhode.train.descriptor.batches import PatchBatches
from polhode.train.descriptor.scores import ValidationPair, describe_patches, score, validation_pairs
from polhode.train.descriptor.surface_points import prepare_points
from polhode.train.task import Batch

RELIABILITY_WEIGHT = DIRECTION_WEIGHT = 0.3
"""Weights of these losses beside that of the descriptor."""
MATCHING_WEIGHT, MOTION_WEIGHT = 0.1, 0.5
"""Weights of the losses of the soft matches and of the motion that they determine."""
LATE_FROM = 0.6
"""Share of the steps after which matches and motion are learned from: before, too few are correct."""
START_TEMPERATURE = 0.07
MAX_MOTION_LOSS = 2.0
"""Largest useful motion loss: a motion with larger errors is merely wrong and contributes no gradient."""


class Heads(nn.Module):
    """Further trained parameters: the temperature of the contrast, and the matcher's temperature and
    dustbin."""

    def __init__(self) -> None:
        super().__init__()
        self.logarithm = nn.Parameter(torch.tensor(START_TEMPERATURE).log())
        self.matcher = DualSoftmax()

    def temperature(self) -> Tensor:
        """Divisor of the similarities, at least 0.02."""
        return self.logarithm.exp().clamp(min=0.02)

    def matcher_parameters(self) -> dict[str, float]:
        """The matcher's temperature and dustbin, for the scores."""
        return {
            "matcher_temperature": float(self.matcher.log_temperature.detach().exp()),
            "matcher_dustbin": float(self.matcher.dustbin.detach()),
        }


def descriptor_loss(
    described: DescriptorOutput, batch: Batch, heads: Heads
) -> tuple[Tensor, Mapping[str, Tensor]]:
    """Loss and its terms for a batch of ``PatchBatches``; the n patches are described in the order of the
    batch."""
    temperature = heads.temperature()
    m = len(batch["pair"])
    descriptors = described.descriptor
    a, b, distractor = descriptors[:m].float(), descriptors[m : 2 * m].float(), descriptors[2 * m :].float()
    # Different pairs that show nearly the same point are not negatives of each other.
    # points of one frame pair that are this close to each other are not used as negatives of each other [px]
    near = sum(torch.cdist(batch[uv], batch[uv]) < 4.0 for uv in ("uv_a", "uv_b")) > 0
    same = (near & (batch["pair"][:, None] == batch["pair"][None, :])).fill_diagonal_(False)
    forward = (a @ b.T).masked_fill(same, -1.0)
    backward = forward.T.masked_fill(same.T, -1.0)
    # Distractors were found in the second frames: they compete with the second patches.
    logits_ab = torch.cat([forward, a @ distractor.T], dim=1) / temperature
    logits_ba = backward / temperature
    truth = torch.arange(m, device=a.device)
    contrast = 0.5 * (functional.cross_entropy(logits_ab, truth) + functional.cross_entropy(logits_ba, truth))
    right = (logits_ab.argmax(dim=1) == truth) & (logits_ba.argmax(dim=1) == truth)
    label = torch.cat([right, right, right.new_zeros(len(distractor))]).float()
    trust = functional.binary_cross_entropy_with_logits(described.reliability.float(), label)
    found = (logits_ab.argmax(dim=1) == truth).float().mean()
    direction = described.direction.float()
    rotation_error = (1.0 - rotation_agreement(direction[:m], direction[m : 2 * m], batch["rotation"])).mean()
    assignment, motion = matching_loss(described, batch, heads.matcher)
    loss = contrast + RELIABILITY_WEIGHT * trust + DIRECTION_WEIGHT * rotation_error
    loss = loss + batch["late"] * (MATCHING_WEIGHT * assignment + MOTION_WEIGHT * motion)
    return loss, {
        "contrast": contrast,
        "reliability": trust,
        "direction": rotation_error,
        "assignment": assignment,
        "motion": motion,
        "rank_1": found,
        "temperature": temperature,
    }


def rotation_agreement(first: Tensor, second: Tensor, turn_rad: Tensor) -> Tensor:
    """Cosine (m,) of the error of the second directions (m, 2), by the first ones and the true rotation."""
    c, s = torch.cos(turn_rad), torch.sin(turn_rad)
    expected = torch.stack([c * first[:, 0] - s * first[:, 1], s * first[:, 0] + c * first[:, 1]], dim=1)
    return (expected * second).sum(dim=1)


def matching_loss(described: DescriptorOutput, batch: Batch, matcher: DualSoftmax) -> tuple[Tensor, Tensor]:
    """Loss of the assignment and loss of the motion: means over the frame pairs of a ``PatchBatches``
    batch."""
    pair, owner = batch["pair"], batch["distractors"]
    m, count = len(pair), len(batch["X_AB"])
    a, b, distractor = (each.float() for each in described.descriptor.split([m, m, len(owner)]))
    firsts, seconds = Grouping.of(pair, count), Grouping.of(torch.cat([pair, owner]), count)
    descriptors = firsts.spread(a), seconds.spread(torch.cat([b, distractor]))
    known = firsts.known(), seconds.known()
    excluded = ~(known[0][:, :, None] & known[1][:, None, :])
    log_p = matcher(*descriptors, excluded)
    points = known[0].sum(dim=1)
    enough = points >= 8  # frame pairs with fewer points do not determine a motion
    # the second points of the pairs come before the distractors
    hits = firsts.sums(log_p[pair, firsts.rank, firsts.rank]) / points.clamp(min=1)
    # logarithm of the probability that a second point has no partner among the first ones
    sharpness = torch.exp(-matcher.log_temperature)
    score = (descriptors[1] @ descriptors[0].transpose(1, 2)) * sharpness
    score = score.masked_fill(~known[0][:, None, :], EXCLUDED_SCORE)
    none = matcher.dustbin * sharpness
    alone = none - torch.logaddexp(torch.logsumexp(score, dim=2), none)
    lost = Grouping(owner, seconds.rank[m:], count, seconds.longest)
    alone = lost.sums(lost.gather(alone)) / lost.sums(torch.ones_like(owner)).clamp(min=1)
    assignment = -0.5 * hits - alone
    motion = motion_loss(
        log_p,
        firsts.spread(batch["p_a"]),
        seconds.spread(torch.cat([batch["p_b"], batch["p_distractor"]])),
        batch["X_AB"],
        known,
    )
    pairs = enough.sum().clamp(min=1)
    return (assignment * enough).sum() / pairs, (motion * enough).sum() / pairs


def motion_loss(
    log_probability: Tensor, p_A: Tensor, p_B: Tensor, X_AB: Tensor, known: tuple[Tensor, Tensor]
) -> Tensor:
    """Errors (c,) of the motions of the soft matches: the mean displacement of points, over their spread.

    log_probability (c, n, m) of ``DualSoftmax``; p_A (c, n, 3), p_B (c, m, 3) [m]; X_AB (c, 4, 4): the true
    motions; known (c, n), (c, m): which of the points there are. Mutually best pairs are fitted with their
    probabilities as weights; the choice of pairs has no gradient, nor has a motion that is merely wrong.
    """
    best = log_probability.argmax(dim=2)
    rows = torch.arange(log_probability.shape[1], device=best.device)
    mutual = known[0] & known[1].gather(1, best) & (log_probability.argmax(dim=1).gather(1, best) == rows)
    weight = (log_probability.gather(2, best[..., None])[..., 0].exp() + 1e-6) * mutual
    partner = p_B.gather(1, best[..., None].expand(-1, -1, 3))
    with torch.no_grad():
        error = _motion_error(p_A, partner, weight, p_B, X_AB, known[1])
        # Fewer points leave the rotation open, and its derivative infinite.
        # matches to which a motion is fitted that is learned from, at least
        good = torch.nonzero((error < MAX_MOTION_LOSS) & (mutual.sum(dim=1) >= 4))[:, 0]
    learned = _motion_error(p_A[good], partner[good], weight[good], p_B[good], X_AB[good], known[1][good])
    return error.clamp(max=MAX_MOTION_LOSS).index_put((good,), learned)


def _motion_error(
    p_A: Tensor, partner: Tensor, weight: Tensor, p_B: Tensor, X_AB: Tensor, known: Tensor
) -> Tensor:
    R, t = rigid_fit(p_A, partner, weight.clamp(min=1e-12))
    off = p_B @ (R - X_AB[:, :3, :3]).transpose(1, 2) + (t - X_AB[:, :3, 3])[:, None]
    count = known.sum(dim=1).clamp(min=1)
    miss = (torch.linalg.vector_norm(off, dim=2) * known).sum(dim=1) / count
    middle = (p_B * known[..., None]).sum(dim=1) / count[:, None]
    spread = (torch.linalg.vector_norm(p_B - middle[:, None], dim=2) * known).sum(dim=1) / count
    error: Tensor = miss / spread.clamp(min=1e-9)
    return error


class DescriptorTask:
    """The task ``descriptor``."""

    name = "descriptor"

    def __init__(self, batches: PatchBatches, trials: list[ValidationPair], late_from: int) -> None:
        """``late_from``: first step whose loss contains matches and motion."""
        self._batches, self._trials, self._late_from = batches, trials, late_from
        self.network, self._heads = DescriptorNet(), Heads()
        self.model = nn.ModuleDict({"network": self.network, "heads": self._heads})

    def batch(self, step: int) -> Batch:
        """Patches of step ``step``."""
        return self._batches.batch(step) | {"late": torch.tensor(float(step >= self._late_from))}

    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        """Contrast, reliability and direction; in later steps also matches and motion."""
        described = self.network(batch["patches"])
        with torch.autocast(batch["patches"].device.type, enabled=False):
            # Similarities over a small temperature, and fits, need full precision.
            return descriptor_loss(described, batch, self._heads)

    def validate(self) -> Mapping[str, float]:
        """Scores on the held-out bodies, and the matcher's parameters."""
        found = score(self._trials, lambda patches: describe_patches(self.network, patches))
        return found | self._heads.matcher_parameters()


def make_task(train: Train, seed: int, progress: Progress, workers: int) -> DescriptorTask:
    """Render the corpus and find its points. Raises InputError: there are too few."""
    render_corpus(train.corpus, progress, workers)
    halves = split(train.corpus)
    scenes = prepare_points(train.corpus, range(train.corpus.scenes), progress, workers)
    batches = PatchBatches({i: scenes[i] for i in halves.training}, train.descriptor, seed)
    if batches.is_empty:
        raise InputError(
            "train.corpus: no two frames show enough common points: more scenes or frames, or smaller turns"
        )
    trials = validation_pairs({i: scenes[i] for i in halves.validation}, seed)
    return DescriptorTask(batches, trials, round(LATE_FROM * train.schedule.steps))
