"""The surface network as a task of the training loop, and its loss.

Terms of the loss:

- *score*: penalty-reduced focal loss on the map of landmarks (Lin et al., "Focal loss for dense object
  detection", 2017; Zhou et al., "Objects as points", 2019);
- *place*: negative log likelihood of the landmark's place at the pixels near it, by Student's t, so that
  the standard deviations are learned with the places;
- *light*: cross entropy of the kind of light on the target's pixels;
- *contrast*, *reliability*, *direction*, *assignment*, *motion*: of the descriptors, as
  ``train.descriptor.task``, but for the points at the places that the network itself gives;
- *consistency*: negative log likelihood of the difference between the place in one image, transformed to the
  other by the true motion, and the place there. It teaches the places alone: what errs alike in both images
  is not in their difference, so that the standard deviations that it asks for are too small.
"""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from polhode.config.train_settings import SurfaceTraining, Train
from polhode.frontend.networks.descriptor import DescriptorOutput
from polhode.frontend.networks.surface import KINDS_OF_LIGHT, DenseOutput, SurfaceNet, sample_rings
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress
from polhode.train.descriptor.task import Heads, descriptor_loss
from polhode.train.surface.batches import batch_of, draw_example
from polhode.train.surface.landmarks import KnownBody, corpus_of, prepare_bodies
from polhode.train.surface.scores import Trial, score_trials, trials_of
from polhode.train.task import Batch

WEIGHT_OF_LIGHT = (1.0, 1.0, 1.0, 4.0)
"""Highlights are rare."""
LATE_FROM = 0.4
"""Share of the steps after which matches, motion and consistency are learned from."""
MAX_OFFSET_PX, MAX_STRETCH = 2.0, 1.1
"""Bounds of the places [px] and of their depths, over the true ones, while the network knows nothing yet."""
NEXT_CORPUS = 10_000_000
"""Added to the numbers of bodies for each further corpus."""
_TRIES = 20


class SurfaceTask:
    """The task ``surface``."""

    name = "surface"

    def __init__(
        self,
        bodies: Mapping[int, KnownBody],
        trials: list[Trial],
        config: SurfaceTraining,
        seed: int,
        late: int,
    ) -> None:
        """``late``: first step whose loss contains all terms."""
        self._bodies, self._numbers, self._trials = bodies, sorted(bodies), trials
        self._config, self._seed, self._late = config, seed, late
        self.network, self._heads = SurfaceNet(), Heads()
        self.model = nn.ModuleDict({"network": self.network, "heads": self._heads})

    def batch(self, step: int) -> Batch:
        """Pairs of images of step ``step``.

        Raises InputError: no body has two images with common landmarks.
        """
        config, rng = self._config, np.random.default_rng([self._seed, 0x5BA7, step])
        examples = []
        for _ in range(_TRIES * config.pairs):
            known = self._bodies[self._numbers[rng.integers(len(self._numbers))]]
            example = draw_example(known, rng, config.crop_px, config.kinds, config.wide)
            if example is not None:
                examples.append(example)
            if len(examples) == config.pairs:
                break
        if not examples:
            raise InputError(
                "train.surface: no body has two images with common landmarks: render more bodies"
            )
        batch = batch_of(examples, config.points, rng)
        return batch | {"late": torch.tensor(float(step >= self._late))}

    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        """See the module."""
        dense = self.network.dense(batch["images"])
        rings = sample_rings(dense.channels, batch["owner"], batch["uv"], batch["affine"])
        described = self.network.describe(rings)
        with torch.autocast(batch["images"].device.type, enabled=False):
            return surface_loss(dense, described, batch, self._heads, self._config)

    def validate(self) -> Mapping[str, float]:
        """Scores on the held-out bodies, and the matcher's parameters."""
        return score_trials(self.network, self._trials) | self._heads.matcher_parameters()


def surface_loss(
    dense: DenseOutput, described: DescriptorOutput, batch: Batch, heads: Heads, config: SurfaceTraining
) -> tuple[Tensor, Mapping[str, Tensor]]:
    """Loss and its terms."""
    weights = config.loss
    own, points = [], []
    for side in ("a", "b"):
        uv, log_sigma = place_at(dense, batch, side)
        # a weak landmark's place is known as the truth gives it, and not to the network
        own.append((torch.where(batch["is_strict"][:, None], uv, batch[f"uv_{side}"]), log_sigma))
        points.append(surface_point(own[-1][0], batch, side))
    loss, terms = descriptor_loss(
        described,
        {**batch, "p_a": points[0], "p_b": points[1], "late": batch["late"] * weights.motion},
        heads,
    )
    score = score_loss(dense.score, batch["heat"], batch["weight"])
    place = place_loss(dense, batch)
    light = light_loss(dense.light, batch["light"])
    consistency = consistency_loss(own, points[1], batch)
    loss = (
        loss
        + weights.score * score
        + weights.place * place
        + weights.light * light
        + weights.consistency * batch["late"] * consistency
    )
    return loss, {**terms, "score": score, "place": place, "light": light, "consistency": consistency}


def score_loss(score: Tensor, heat: Tensor, weight: Tensor) -> Tensor:
    """Focal loss of logits (b, H, W): heat (b, H, W) is 1 at landmarks and falls off around them."""
    p = torch.sigmoid(score).clamp(1e-5, 1.0 - 1e-5)
    heat = heat.float()
    at = heat >= 1.0
    hit = -((1.0 - p) ** 2) * torch.log(p) * at
    miss = -((1.0 - heat) ** 4) * p**2 * torch.log(1.0 - p) * (~at)
    loss: Tensor = ((hit + miss) * weight).sum() / at.sum().clamp(min=1)
    return loss


def student_nll(square: Tensor, log_sigma: Tensor) -> Tensor:
    """Negative log likelihood of two-dimensional differences of squared length ``square`` [px^2], up to a
    constant."""
    nu = 5.0  # of Student's t
    return 0.5 * (nu + 2.0) * torch.log1p(square * torch.exp(-2.0 * log_sigma) / nu) + 2.0 * log_sigma


def place_loss(dense: DenseOutput, batch: Batch) -> Tensor:
    """Mean over the pixels near landmarks."""
    image, row, column = batch["near"].T
    away = dense.offset_px[image, :, row, column] - batch["place"]
    return student_nll((away**2).sum(dim=1), dense.log_sigma[image, row, column]).mean()


def light_loss(logits: Tensor, kind: Tensor) -> Tensor:
    """Cross entropy over the pixels that show the target."""
    weight = logits.new_tensor(WEIGHT_OF_LIGHT)
    return functional.cross_entropy(logits, kind.long(), weight, ignore_index=KINDS_OF_LIGHT)


def place_at(dense: DenseOutput, batch: Batch, side: str) -> tuple[Tensor, Tensor]:
    """Places (m, 2) [px] that the network gives to the landmarks of one side, and their log sigma (m,)."""
    image, pixel = 2 * batch["pair"] + "ab".index(side), batch[f"uv_{side}"].round().long()
    column, row = pixel.T
    offset = dense.offset_px[image, :, row, column].clamp(-MAX_OFFSET_PX, MAX_OFFSET_PX)
    return pixel + offset, dense.log_sigma[image, row, column]


def surface_point(uv_px: Tensor, batch: Batch, side: str) -> Tensor:
    """Points (m, 3) [m] of the landmarks' planes at places (m, 2), in the camera of their side."""
    pair = batch["pair"]
    xy = (uv_px - batch[f"centre_{side}"][pair]) / batch["focal"][pair, None]
    ray = torch.cat([xy, torch.ones_like(xy[:, :1])], dim=1)
    depth = 1.0 / (batch[f"plane_{side}"] * ray).sum(dim=1, keepdim=True)
    # Planes seen at a grazing angle have no depth beyond their rim.
    truth = batch[f"p_{side}"][:, 2:]
    return ray * torch.maximum(torch.minimum(depth, MAX_STRETCH * truth), truth / MAX_STRETCH)


def consistency_loss(own: list[tuple[Tensor, Tensor]], p_B: Tensor, batch: Batch) -> Tensor:
    """Mean over the landmarks of pairs that are no weak ones; p_B (m, 3): the points in the second camera."""
    pair = batch["pair"]
    X = batch["X_AB"][pair]
    p_A = torch.einsum("nij,nj->ni", X[:, :3, :3], p_B) + X[:, :3, 3]
    uv = p_A[:, :2] / p_A[:, 2:] * batch["focal"][pair, None] + batch["centre_a"][pair]
    m = len(pair)
    area = torch.linalg.det(batch["affine"])
    stretch = 0.5 * torch.log((area[:m] / area[m : 2 * m]).abs().clamp(0.1, 10.0))
    log_var = torch.logaddexp(2.0 * own[0][1], 2.0 * (own[1][1] + stretch)).detach()
    each = student_nll(((uv - own[0][0]) ** 2).sum(dim=1), 0.5 * log_var)
    strict = batch["is_strict"].float()
    return (each * strict).sum() / strict.sum().clamp(min=1.0)


def make_task(train: Train, seed: int, progress: Progress, workers: int) -> SurfaceTask:
    """Render the bodies and find their landmarks. Raises InputError as ``prepare_bodies``."""
    learned, held_out, corpora = dict[int, KnownBody](), dict[int, KnownBody](), 0
    for k in range(1 + len(train.surface.more)):
        corpus, config = corpus_of(train, k)
        for i, known in prepare_bodies(corpus, config, progress, workers).items():
            if not corpus.is_validation(i):
                copies = train.surface.more[k - 1].weight if k else 1
                learned |= {(corpora + n) * NEXT_CORPUS + i: known for n in range(copies)}
            elif k == 0:
                held_out[i] = known
        corpora += train.surface.more[k - 1].weight if k else 1
    late = round(LATE_FROM * train.schedule.steps) if train.start_from is None else 0
    return SurfaceTask(learned, trials_of(held_out, seed), train.surface, seed, late)
