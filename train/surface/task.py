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
  is not in their difference, so that the standard deviations that it asks for are too small;
- *consensus*: the same for three images of a body: negative log likelihood of the deviation of each place
  from the weighted mean of the other two, carried to it by the true motion;
- *albedo*: negative log probability that a point is more similar to itself in the other image than to the
  same place there under another albedo: what both albedos have in common is shape and shading.
"""

from collections.abc import Mapping
from typing import NamedTuple

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
from polhode.train.surface.batches import KnownBody, batch_of, draw_example
from polhode.train.surface.known_bodies import NEXT_ALBEDO, corpus_of, prepare_bodies
from polhode.train.surface.scores import Trial, score_trials, trials_of
from polhode.train.task import Batch

DEGREES_OF_FREEDOM = 5.0
"""Of Student's t."""
WEIGHT_OF_LIGHT = (1.0, 1.0, 1.0, 4.0)
"""Highlights are rare."""
LATE_FROM = 0.4
"""Share of the steps after which matches, motion and consistency are learned from."""
MAX_OFFSET_PX, MAX_STRETCH = 2.0, 1.1
"""Bounds of the places [px] and of their depths, over the true ones, while the network knows nothing yet."""
NEXT_CORPUS = 100 * NEXT_ALBEDO
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
        self._network, self._heads = SurfaceNet(), Heads()
        self._model = nn.ModuleDict({"network": self._network, "heads": self._heads})

    @property
    def model(self) -> nn.Module:
        """The network and the heads."""
        return self._model

    @property
    def network(self) -> nn.Module:
        """The surface network, whose weights are written."""
        return self._network

    def batch(self, step: int) -> Batch:
        """Pairs of images of step ``step``.

        Raises InputError: no body has two images with common landmarks.
        """
        rng = np.random.default_rng([self._seed, 0x5BA7, step])
        examples = []
        for _ in range(_TRIES * self._config.pairs):
            known = self._bodies[self._numbers[rng.integers(len(self._numbers))]]
            example = draw_example(
                known,
                rng,
                self._config.crop_px,
                self._config.kinds,
                self._config.wide,
                self._config.loss.consensus > 0.0,
            )
            if example is not None:
                examples.append(example)
            if len(examples) == self._config.pairs:
                break
        if not examples:
            raise InputError(
                "train.surface: no body has two images with common landmarks: render more bodies"
            )
        batch = batch_of(examples, self._config.points, rng)
        return batch | {"late": torch.tensor(float(step >= self._late))}

    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        """See the module."""
        dense = self._network.dense(batch["images"])
        rings = sample_rings(dense.channels, batch["owner"], batch["uv"], batch["affine"])
        described = self._network.describe(rings)
        with torch.autocast(batch["images"].device.type, enabled=False):
            return surface_loss(dense, described, batch, self._heads, self._config)

    def validate(self) -> Mapping[str, float]:
        """Scores on the held-out bodies, and the matcher's parameters."""
        matcher = self._heads.matcher
        return score_trials(self._network, self._trials) | {
            "matcher_temperature": float(matcher.log_temperature.detach().exp()),
            "matcher_dustbin": float(matcher.dustbin.detach()),
        }


def surface_loss(
    dense: DenseOutput, described: DescriptorOutput, batch: Batch, heads: Heads, config: SurfaceTraining
) -> tuple[Tensor, Mapping[str, Tensor]]:
    """Loss and its terms."""
    weights = config.loss
    own = [place_at(dense, batch, side) for side in ("a", "b")]
    # a weak landmark's place is known as the truth gives it, and not to the network
    own = [
        (torch.where(batch["is_strict"][:, None], uv, batch[f"uv_{side}"]), log_sigma)
        for (uv, log_sigma), side in zip(own, ("a", "b"), strict=True)
    ]
    points = [surface_point(place, batch, side) for place, side in zip(own, ("a", "b"), strict=True)]
    loss, terms = descriptor_loss(
        _without_others(described, batch),
        {**batch, "p_a": points[0], "p_b": points[1], "late": batch["late"] * weights.motion},
        heads,
    )
    score = score_loss(dense.score, batch["heat"], batch["weight"])
    place = place_loss(dense, batch)
    light = light_loss(dense.light, batch["light"])
    consistency = consistency_loss(dense, own, points, batch)
    loss = (
        loss
        + weights.score * score
        + weights.place * place
        + weights.light * light
        + weights.consistency * batch["late"] * consistency
    )
    terms = {**terms, "score": score, "place": place, "light": light, "consistency": consistency}
    if weights.consensus > 0.0:
        consensus = place.new_zeros(())
        if "third" in batch:
            consensus = consensus_loss(views_of(dense, own, points, batch))
        loss = loss + weights.consensus * batch["late"] * consensus
        terms["consensus"] = consensus
    if "other" in batch:
        albedo = albedo_loss(described.descriptor.float(), batch, heads.temperature().detach())
        loss = loss + weights.albedo * albedo
        terms["albedo"] = albedo
    return loss, terms


def _without_others(described: DescriptorOutput, batch: Batch) -> DescriptorOutput:
    """Points of the pairs and distractors, without those under another albedo, which come last."""
    count = 2 * len(batch["pair"]) + len(batch["distractors"])
    return DescriptorOutput(*(each[:count] for each in described))


def albedo_loss(descriptor: Tensor, batch: Batch, temperature: Tensor) -> Tensor:
    """Mean over the points that are seen under another albedo; descriptor (2 m + d + o, dimensions)."""
    m = len(batch["pair"])
    first, second = descriptor[batch["other"]], descriptor[m + batch["other"]]
    other = descriptor[2 * m + len(batch["distractors"]) :]
    lead = (first * second).sum(dim=1) - (first * other).sum(dim=1)
    return functional.softplus(-lead / temperature).mean()


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
    nu = DEGREES_OF_FREEDOM
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
    return place_near(dense, 2 * batch["pair"] + (0 if side == "a" else 1), batch[f"uv_{side}"])


def place_near(dense: DenseOutput, image: Tensor, uv_px: Tensor) -> tuple[Tensor, Tensor]:
    """Places (n, 2) [px] that the network gives to landmarks at uv_px (n, 2) of images (n,), and their log
    sigma (n,)."""
    pixel = uv_px.round().long()
    column, row = pixel.T
    offset = dense.offset_px[image, :, row, column].clamp(-MAX_OFFSET_PX, MAX_OFFSET_PX)
    return pixel + offset, dense.log_sigma[image, row, column]


def surface_point(place: tuple[Tensor, Tensor], batch: Batch, side: str) -> Tensor:
    """Points (m, 3) [m] of the landmarks' planes at places (m, 2), in the camera of their side."""
    pair = batch["pair"]
    return on_plane(
        place[0],
        batch[f"centre_{side}"][pair],
        batch["focal"][pair],
        batch[f"plane_{side}"],
        batch[f"p_{side}"][:, 2],
    )


def on_plane(uv_px: Tensor, centre_px: Tensor, focal_px: Tensor, plane: Tensor, depth_m: Tensor) -> Tensor:
    """Points (n, 3) [m] of the planes (n, 3), n / (n . p), at places (n, 2); depth_m (n,): the true ones."""
    xy = (uv_px - centre_px) / focal_px[:, None]
    ray = torch.cat([xy, torch.ones_like(xy[:, :1])], dim=1)
    depth = 1.0 / (plane * ray).sum(dim=1, keepdim=True)
    # Planes seen at a grazing angle have no depth beyond their rim.
    truth = depth_m[:, None]
    return ray * torch.maximum(torch.minimum(depth, MAX_STRETCH * truth), truth / MAX_STRETCH)


def consistency_loss(
    dense: DenseOutput, own: list[tuple[Tensor, Tensor]], points: list[Tensor], batch: Batch
) -> Tensor:
    """Mean over the landmarks of pairs that are no weak ones."""
    pair = batch["pair"]
    X = batch["X_AB"][pair]
    p_A = torch.einsum("nij,nj->ni", X[:, :3, :3], points[1]) + X[:, :3, 3]
    uv = p_A[:, :2] / p_A[:, 2:] * batch["focal"][pair, None] + batch["centre_a"][pair]
    m = len(pair)
    area = torch.linalg.det(batch["affine"])
    stretch = 0.5 * torch.log((area[:m] / area[m : 2 * m]).abs().clamp(0.1, 10.0))
    log_var = torch.logaddexp(2.0 * own[0][1], 2.0 * (own[1][1] + stretch)).detach()
    each = student_nll(((uv - own[0][0]) ** 2).sum(dim=1), 0.5 * log_var)
    strict = batch["is_strict"].float()
    return (each * strict).sum() / strict.sum().clamp(min=1.0)


class Views(NamedTuple):
    """n landmarks in V images each."""

    uv_px: Tensor
    """(V, n, 2) places"""
    log_sigma: Tensor
    """(V, n) their standard deviations [log px]"""
    p_A: Tensor
    """(V, n, 3) on the surface, in the camera of the first image [m]"""
    X_VA: Tensor
    """(V, n, 4, 4) the first image's camera in each"""
    log_area: Tensor
    """(V, n) image of a unit of surface [log px^2/m^2]"""
    centre_px: Tensor
    """(V, n, 2) principal points"""
    focal_px: Tensor
    """(n,)"""


def views_of(
    dense: DenseOutput, own: list[tuple[Tensor, Tensor]], points: list[Tensor], batch: Batch
) -> Views:
    """The landmarks that third images show."""
    row = batch["third"]
    pair = batch["pair"][row]
    focal = batch["focal"][pair]
    uv, log_sigma = place_near(dense, batch["image_third"], batch["uv_third"])
    p = on_plane(uv, batch["centre_third"], focal, batch["plane_third"], batch["p_third"][:, 2])
    X_AV = torch.stack(
        [
            torch.eye(4, dtype=p.dtype, device=p.device).expand(len(row), 4, 4),
            batch["X_AB"][pair],
            batch["X_A_third"],
        ]
    )
    p_V = torch.stack([points[0][row], points[1][row], p])
    truth = torch.stack([batch["p_a"][row], batch["p_b"][row], batch["p_third"]])
    plane = torch.stack([batch["plane_a"][row], batch["plane_b"][row], batch["plane_third"]])
    # planes are n / (n . p)
    cosine = 1.0 / (torch.linalg.vector_norm(plane, dim=2) * torch.linalg.vector_norm(truth, dim=2))
    return Views(
        uv_px=torch.stack([own[0][0][row], own[1][0][row], uv]),
        log_sigma=torch.stack([own[0][1][row], own[1][1][row], log_sigma]),
        p_A=_moved(X_AV, p_V),
        X_VA=torch.linalg.inv(X_AV),
        log_area=torch.log(cosine) + 2.0 * torch.log(focal / truth[:, :, 2]),
        centre_px=torch.stack([batch["centre_a"][pair], batch["centre_b"][pair], batch["centre_third"]]),
        focal_px=focal,
    )


def consensus_loss(views: Views) -> Tensor:
    """Mean over landmarks and images of how the place in one image deviates from the mean of the others.

    As in ``consistency_loss``, standard deviations are not learned from it.
    """
    precision = torch.exp(views.log_area - 2.0 * views.log_sigma).detach()
    others = 1.0 - torch.eye(len(precision), dtype=precision.dtype, device=precision.device)
    of_others = torch.einsum("vw,wn->vn", others, precision)
    mean_A = torch.einsum("vw,wnk->vnk", others, precision[..., None] * views.p_A) / of_others[..., None]
    mean = _moved(views.X_VA, mean_A)
    uv = mean[..., :2] / mean[..., 2:] * views.focal_px[None, :, None] + views.centre_px
    log_var = torch.logaddexp(2.0 * views.log_sigma, views.log_area - torch.log(of_others)).detach()
    return student_nll(((uv - views.uv_px) ** 2).sum(dim=2), 0.5 * log_var).mean()


def _moved(X: Tensor, p: Tensor) -> Tensor:
    """Points (V, n, 3) by poses (V, n, 4, 4)."""
    return torch.einsum("vnij,vnj->vni", X[..., :3, :3], p) + X[..., :3, 3]


def make_task(train: Train, seed: int, progress: Progress, workers: int) -> SurfaceTask:
    """Render the bodies and find their landmarks. Raises InputError as ``prepare_bodies``."""
    config = train.surface
    bodies = prepare_bodies(train.corpus, config, progress, workers)
    is_held_out = {i: train.corpus.is_validation(i % NEXT_ALBEDO) for i in bodies}
    learned = {i: known for i, known in bodies.items() if not is_held_out[i]}
    held_out = {i: known for i, known in bodies.items() if is_held_out[i]}
    corpora = 0
    for k, more in enumerate(config.more, 1):
        others = prepare_bodies(*corpus_of(train, k), progress, workers)
        own = {i: known for i, known in others.items() if not more.corpus.is_validation(i % NEXT_ALBEDO)}
        for _ in range(more.weight):
            corpora += 1
            learned |= {corpora * NEXT_CORPUS + i: known for i, known in own.items()}
    late = round(LATE_FROM * train.schedule.steps) if train.start_from is None else 0
    return SurfaceTask(learned, trials_of(held_out, seed), config, seed, late)
