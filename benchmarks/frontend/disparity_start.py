"""Whether the backbone of the surface network gives a start of disparity as good as OpenCV's matching.

    python -m benchmarks.frontend.disparity_start [--short] [--bodies 70] [--steps 400] [--whole]

The backbone sees the left and the right image of the target. A cost volume has one less the inner products of
its channels along the rows; it is aggregated, the best disparity wins, a parabola gives the place between
pixels. What the right image contradicts, the dark, and specks are removed by the rules of ``sgbm``. The rows:

    sgbm        OpenCV's semi-global matching, with which the front end begins
    image       patches of 5 x 5 pixels of the left and the right image, which need no network
    channels    the channels of the rings, two of the image and six learned, as they are
    head        sixteen channels by one layer from the judged features of the frozen backbone, trained here on
                the true disparities of the corpus's bodies; with --whole the backbone learns with it

"box" is the mean over a window, "paths" the sum of eight paths of semi-global matching. Bodies of the corpus
are rendered when missing. Windows and penalties are the best ones of a grid on its held-out bodies. Scenes,
mask, range and counted pixels are those of ``benchmarks.frontend.disparity``.

Columns: density [%]; share of the found disparities off by more than 1 px [%], of all, and at the density of
sgbm (the most distinct ones); median error [px]; milliseconds of a core, medians over the pairs: of what
follows the backbone, and of its look at the right image. Its look at the left image counts as detection's.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import process_time
from typing import Annotated

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional
from tyro.conf import arg

from benchmarks.command import ROOT, Configuration, Short, command
from benchmarks.frontend.disparity import all_methods, measure, row, test_sequences
from benchmarks.presentation import print_table
from polhode.compiled import compiled_reordered
from polhode.config.loader import load_config
from polhode.frontend.disparity.sgbm import CONSISTENCY_PX, SPECKLE_PX, Floats, StereoCrop
from polhode.frontend.features.surface_network import surface_network
from polhode.frontend.networks.precision import multiplies_in_bfloat16
from polhode.frontend.networks.surface import CHANNELS, JUDGED, STRIDE_PX, SurfaceNet, local_contrast
from polhode.frontend.rectification import Image, target_crop
from polhode.frontend.segmentation import target_mask
from polhode.progress import Silent
from polhode.records import Bools
from polhode.train.corpus import required_train
from polhode.train.surface.lit_bodies import (
    LitBody,
    lit_body_path,
    on_target,
    read_lit_body,
    render_lit_bodies,
)

CONFIG = ROOT / "configs/train/surface.yaml"
HEAD = "scene | method | density | bad 1 px | at equal density | median px | ms | ms right look"
HEAD_CHANNELS = 16
PATCH_PX = 5
"""Side of the patches of ``image``."""
PATCH_NOISE = 0.02
"""Contrast of noise in a patch, in units of the image's channel."""
BLOCK_PX, BOX_PX = 5, 9
"""Windows of the means before "paths" and for "box"."""
STEPS_OF_COST = 16.0
"""Steps of a unit of the penalties: costs of paths are integers."""
SMALL, LARGE = 0.5, 8.0
"""Penalties of a step of one disparity, and of a larger one."""
COST_SCALES = {"image": 1.5, "channels": 1.5, "head": 3.0}
"""Costs of inner product 0, in the same unit."""
WINDOW_PX = 96
"""Rows of a pair that a step of the training looks at."""
MIN_PIXELS = 200
"""A pair with fewer pixels of known disparity is not learned from."""
MIN_INTENSITY = 8.0
"""Darker pixels are not learned from."""
Costs = NDArray[np.int16]


class StartHead(nn.Module):
    """Unit vectors (b, c, H, W) from the judged features (b, JUDGED, H, W)."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Conv2d(JUDGED, HEAD_CHANNELS, 1)
        self.log_scale = nn.Parameter(torch.tensor(2.5))
        """Logarithm of the logit of inner product 1"""

    def forward(self, judged: Tensor) -> Tensor:
        """See the class."""
        return functional.normalize(self.layer(judged), dim=1)


@dataclass(frozen=True)
class Seen:
    """What the backbone makes of one image (H, W); zero beside the target's part."""

    judged: Tensor
    """(1, JUDGED, H, W)"""
    channels: Tensor
    """(1, CHANNELS, H, W)"""


def look(network: SurfaceNet, image: Image, mask: Bools) -> Seen:
    """Look at the target's part of an image, as ``SurfaceLook`` does with targets of up to 640 px."""
    whole = [torch.zeros(1, n, *image.shape) for n in (JUDGED, CHANNELS)]
    crop = target_crop(mask)
    if crop is None:
        return Seen(*whole)
    wide = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    part = np.where(wide, image, np.uint8(0))[crop.v0 : crop.v1, crop.u0 : crop.u1]
    h, w = part.shape
    framed = np.zeros((-(-h // STRIDE_PX) * STRIDE_PX, -(-w // STRIDE_PX) * STRIDE_PX), np.float32)
    framed[:h, :w] = part
    judged = list[Tensor]()
    hook = network.judge.register_forward_hook(lambda _module, _given, made: judged.append(made))
    with torch.autocast("cpu", torch.bfloat16, enabled=multiplies_in_bfloat16()):
        channels = network.dense(torch.from_numpy(framed)[None, None]).channels
    hook.remove()
    for all_of_it, some in zip(whole, (judged[0].float(), channels), strict=True):
        all_of_it[:, :, crop.v0 : crop.v1, crop.u0 : crop.u1] = some[:, :, :h, :w]
    return Seen(*whole)


Vectors = Callable[[Seen], Tensor]
"""Vectors (1, c, H, W) of which inner products are taken"""


def patch_vectors(seen: Seen) -> Tensor:
    """The patch around each pixel, without its mean, over its contrast."""
    root = functional.pad(seen.channels[:, :1], (PATCH_PX // 2,) * 4, "replicate")
    patches = functional.unfold(root, PATCH_PX).reshape(1, PATCH_PX**2, *seen.channels.shape[2:])
    away = patches - patches.mean(dim=1, keepdim=True)
    floor = (PATCH_PX * PATCH_NOISE) ** 2
    return away / torch.sqrt((away * away).sum(dim=1, keepdim=True) + floor)


def channel_vectors(seen: Seen) -> Tensor:
    """The channels of the rings as one unit vector; those of the image by their contrast."""
    image, learned = seen.channels.split([2, CHANNELS - 2], dim=1)
    return functional.normalize(torch.cat([local_contrast(image), 2.0 * learned], dim=1), dim=1)


@compiled_reordered
def cost_volume(left: Floats, right: Floats, disparities: int) -> Floats:
    """One less the inner products (h, w, disparities) of vectors of the left image (h, c, w) and of the right
    one (h, c, w + disparities). The right one is mirrored: there, larger disparities are further right."""
    h, channels, w = left.shape
    wide = right.shape[2]
    out = np.empty((h, w, disparities), np.float32)
    for v in range(h):
        for u in range(w):
            first = wide - 1 - u - disparities
            row = out[v, u]
            for d in range(disparities):
                row[d] = np.float32(1.0)
            for c in range(channels):
                value = left[v, c, u]
                there = right[v, c]
                for d in range(disparities):
                    row[d] -= value * there[first + d]
    return out


@compiled_reordered
def sum_of_paths(cost: Costs, small: int, large: int) -> Costs:
    """Sum (h, w, n) over eight paths of the least cost up to each pixel, by costs (h, w, n).

    A step of one disparity adds ``small``, a larger one ``large``.
    """
    h, w, n = cost.shape
    total = np.zeros((h, w, n), np.int16)
    far = np.int16(16000)
    for sweep in range(2):
        # Paths from the left, and from three pixels of the row before; mirrored in the second sweep.
        before = np.full((4, w + 2, n + 2), far, np.int16)
        now = np.full((4, w + 2, n + 2), far, np.int16)
        least_before = np.zeros((4, w + 2), np.int16)
        least_now = np.zeros((4, w + 2), np.int16)
        before[:, :, 1 : n + 1] = 0
        now[:, :, 1 : n + 1] = 0
        for k in range(h):
            v = k if sweep == 0 else h - 1 - k
            now[0, 0, 1 : n + 1] = 0
            least_now[0, 0] = 0
            for column in range(w):
                u = column if sweep == 0 else w - 1 - column
                own, summed = cost[v, u], total[v, u]
                for path in range(4):
                    if path == 0:
                        last, least = now[0, column], least_now[0, column]
                    else:
                        last, least = before[path, column + path - 1], least_before[path, column + path - 1]
                    here = now[path, column + 1]
                    jump = np.int16(least + large)
                    lowest = far
                    for d in range(n):
                        best = np.int16(last[d + 1])
                        less, more = np.int16(last[d] + small), np.int16(last[d + 2] + small)
                        best = less if less < best else best
                        best = more if more < best else best
                        best = jump if jump < best else best
                        value = np.int16(np.int16(own[d] + best) - least)
                        here[d + 1] = value
                        summed[d] = np.int16(summed[d] + value)
                        lowest = value if value < lowest else lowest
                    least_now[path, column + 1] = lowest
            before, now = now, before
            least_before, least_now = least_now, least_before
    return total


@compiled_reordered
def best_disparities(cost: Floats | Costs) -> tuple[Floats, Floats, Floats]:
    """Disparities (h, w) by their costs (h, w, n); by how much the second best costs more; and the whole
    disparities (h, w + n) of the right image, by the same costs, -1 where there are none."""
    h, w, n = cost.shape
    found = np.empty((h, w), np.float32)
    margin = np.empty((h, w), np.float32)
    right = np.full((h, w + n), np.float32(-1.0))
    for v in range(h):
        lowest = np.full(w + n, np.float32(1e9))
        for u in range(w):
            own = cost[v, u]
            best, at = np.float32(own[0]), 0
            for d in range(n):
                value = np.float32(own[d])
                if value < best:
                    best, at = value, d
                place = u + n - d
                if value < lowest[place]:
                    lowest[place] = value
                    right[v, place] = np.float32(d)
            second = np.float32(1e9)
            for d in range(n):
                if (d < at - 1 or d > at + 1) and np.float32(own[d]) < second:
                    second = np.float32(own[d])
            margin[v, u] = second - best
            found[v, u] = np.float32(at)
            if 0 < at < n - 1:
                less, more = np.float32(own[at - 1]), np.float32(own[at + 1])
                bend = less + more - np.float32(2.0) * best
                if bend > 0:
                    found[v, u] += np.float32(0.5) * (less - more) / bend
    return found, margin, right


def checked(found: Floats, right: Floats, crop: StereoCrop) -> Floats:
    """Disparities (h, w) as ``match_checked`` gives them: NaN where the right image's (h, w + n) contradict,
    in the dark, and in specks."""
    w = found.shape[1]
    there = np.arange(w)[None, :] + crop.search_px - np.round(found).astype(np.int64)
    back = np.take_along_axis(right, np.clip(there, 0, w + crop.search_px - 1), axis=1)
    good = (found > 0) & (back > 0) & (np.abs(found - back) <= CONSISTENCY_PX) & crop.lit
    specks = np.where(good, np.round(found * 16), -16).astype(np.int16)
    cv2.filterSpeckles(specks, -16, SPECKLE_PX, 16)
    return np.where(specks > 0, found, np.nan).astype(np.float32)


def aggregated(cost: Floats, scale: float | None) -> Floats | Costs:
    """Costs (h, w, n) as means over a window, or as sums over paths by integer costs of a scale."""
    side = BOX_PX if scale is None else BLOCK_PX
    mean = np.asarray(cv2.blur(cost, (side, side), borderType=cv2.BORDER_REPLICATE), np.float32)
    if scale is None:
        return mean
    steps = np.clip(mean * (scale * STEPS_OF_COST), 0, 1000).astype(np.int16)
    return sum_of_paths(steps, int(SMALL * STEPS_OF_COST), int(LARGE * STEPS_OF_COST))


@dataclass
class StartMethod:
    """A ``Method`` of ``benchmarks.frontend.disparity``; it keeps the times of the pairs."""

    network: SurfaceNet
    vectors: Vectors
    cost_scale: float | None
    """None: the mean over a window; otherwise paths, by costs of this scale"""
    after_s: list[float] = field(default_factory=list)
    right_look_s: list[float] = field(default_factory=list)

    @torch.inference_mode()
    def __call__(self, crop: StereoCrop) -> tuple[Floats, Floats]:
        """Disparity of a crop (h, w), and what is smaller where it is more distinct."""
        n, w = crop.search_px, crop.target.shape[1]
        left = look(self.network, crop.image, crop.target)
        begin = process_time()
        right = look(self.network, crop.right, target_mask(crop.right))
        self.right_look_s.append(process_time() - begin)
        begin = process_time()
        mirrored = self.vectors(right)[0, :, :, : w + n].flip(2)
        rows = [each.permute(1, 0, 2).contiguous().numpy() for each in (self.vectors(left)[0], mirrored)]
        cost = aggregated(cost_volume(rows[0], rows[1], n), self.cost_scale)
        disparity, distinct, seen_right = best_disparities(cost)
        found = checked(disparity, seen_right, crop)
        self.after_s.append(process_time() - begin)
        return found, -distinct


@dataclass(frozen=True)
class TrainingPair:
    """Both images of a pose (h, w), the target's masks, and the truth of the left image."""

    left: Image
    mask_left: Bools
    right: Image
    mask_right: Bools
    disparity: Floats
    """(h, w) between the parts [px]; NaN off the target, in the dark, and where the right camera sees
    something else"""


def training_pairs(body: LitBody) -> list[TrainingPair]:
    """The poses of a body under its first Sun, without those of which too little is lit."""
    found = []
    for pose in range(body.poses):
        mask, left, right = on_target(body, pose), body.grey[pose], body.right[pose]
        whole = float(body.focal_px) * float(body.baseline_m) / body.depth_m[pose]
        disparity = (whole - body.shift_px[pose]).astype(np.float32)
        lit = cv2.blur(left.astype(np.float32), (PATCH_PX, PATCH_PX)) > MIN_INTENSITY
        known = mask & lit & seen_by_right(disparity)
        if known.sum() >= MIN_PIXELS:
            truth = np.where(known, disparity, np.nan).astype(np.float32)
            found.append(TrainingPair(left, mask, right, target_mask(right), truth))
    return found


def seen_by_right(disparity: Floats) -> Bools:
    """Pixels (h, w) that no nearer surface of the left image hides from the right camera."""
    h, w = disparity.shape
    v, u = np.nonzero(np.isfinite(disparity))
    there = np.round(u - disparity[v, u]).astype(int)
    inside = (there >= 1) & (there < w - 1)
    v, u, there = v[inside], u[inside], there[inside]
    nearest = np.full((h, w), -np.inf, np.float32)
    for step in (-1, 0, 1):
        np.maximum.at(nearest, (v, there + step), disparity[v, u])
    seen = np.zeros((h, w), bool)
    seen[v, u] = disparity[v, u] > nearest[v, there] - 1.0
    return seen


def loss_of(head: StartHead, left: Seen, right: Seen, disparity: Floats, row: int) -> Tensor:
    """Cross entropy [nats] of the true disparities (h, w) in a window that begins at a row, or as near to it
    as there are any.

    The truth between two whole disparities is shared by both.
    """
    rows, columns = (np.flatnonzero(np.isfinite(disparity).any(axis=axis)) for axis in (1, 0))
    first_row = int(np.clip(row, rows[0], max(rows[-1] + 1 - WINDOW_PX, rows[0])))
    part = slice(first_row, first_row + WINDOW_PX)
    u0, u1 = int(columns[0]), int(columns[-1]) + 1
    truth = disparity[part, u0:u1]
    first, last = (int(f) for f in (np.floor(np.nanmin(disparity)) - 4, np.ceil(np.nanmax(disparity)) + 4))
    before, after = max(last, 0), max(-first, 0)
    vectors = head(left.judged[:, :, part])[0, :, :, u0:u1]
    others = functional.pad(head(right.judged[:, :, part])[0], (before, after))
    start, stop = before + u0, before + u1
    logits = head.log_scale.exp() * torch.stack(
        [(vectors * others[..., start - d : stop - d]).sum(dim=0) for d in range(first, last + 1)]
    )
    v, u = np.nonzero(np.isfinite(truth))
    at, share = np.divmod(truth[v, u] - first, 1.0)
    log_p, at = functional.log_softmax(logits, dim=0), at.astype(int)
    upper = torch.from_numpy(share.astype(np.float32))
    return -((1.0 - upper) * log_p[at, v, u] + upper * log_p[at + 1, v, u]).mean()


def trained_head(network: SurfaceNet, pairs: Sequence[TrainingPair], steps: int, whole: bool) -> StartHead:
    """The head after so many steps of a pair each; with ``whole`` the network is changed, too.

    Statistics of the normalization stay those of the network.
    """
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    head = StartHead()
    groups = [{"params": list(head.parameters()), "lr": 1e-2}]
    if whole:
        groups.append({"params": list(network.parameters()), "lr": 5e-4})
    optimizer = torch.optim.AdamW(groups, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        pair = pairs[int(rng.integers(len(pairs)))]
        with torch.set_grad_enabled(whole):
            left = look(network, pair.left, pair.mask_left)
            right = look(network, pair.right, pair.mask_right)
        optimizer.zero_grad()
        loss = loss_of(head, left, right, pair.disparity, int(rng.integers(len(pair.left))))
        loss.backward()
        optimizer.step()
        schedule.step()
    return head.eval()


def corpus_pairs(config: Path, bodies: int) -> list[TrainingPair]:
    """Those of the first bodies of a configuration's corpus that are not held out; rendered when missing."""
    train = required_train(load_config(config).train, config)
    chosen = [i for i in range(bodies) if not train.corpus.is_validation(i)]
    render_lit_bodies(train.corpus, train.surface, Silent(), 1, chosen)
    paths = [lit_body_path(train.corpus, train.surface, i) for i in chosen]
    return [pair for path in paths for pair in training_pairs(read_lit_body(path))]


def main(
    short: Short = False,
    config: Configuration = CONFIG,
    bodies: Annotated[int, arg(help="Bodies of its corpus, one in nine of which is held out.")] = 70,
    steps: Annotated[int, arg(help="Steps of the training.")] = 400,
    whole: Annotated[bool, arg(help="Train the backbone with the head.")] = False,
) -> None:
    """Print the table."""
    network = surface_network().eval()
    pairs = corpus_pairs(config, 4 if short else bodies)
    head = trained_head(network, pairs, 20 if short else steps, whole)
    vectors: dict[str, Vectors] = {
        "image": patch_vectors,
        "channels": channel_vectors,
        "head": lambda seen: head(seen.judged),
    }
    methods = {
        f"{name}, {kind}": StartMethod(network, each, COST_SCALES[name] if kind == "paths" else None)
        for name, each in vectors.items()
        for kind in ("box", "paths")
    }
    print_table(HEAD, _rows(test_sequences(), methods, 1 if short else None))


def _rows(folders: Sequence[Path], methods: dict[str, StartMethod], pairs: int | None) -> Iterator[list[str]]:
    """One for each scene and method, then the means over the scenes."""
    sgbm = all_methods(None)["sgbm"]
    numbers: dict[str, list[list[float]]] = {name: [] for name in ("sgbm", *methods)}
    for folder in folders:
        peer = measure(folder, sgbm, pairs)
        density = float(np.isfinite(peer.error).mean())
        numbers["sgbm"].append([*row(peer, density)[:4], 1e3 * peer.seconds, 0.0])
        for name, method in methods.items():
            begin = len(method.after_s)
            found = row(measure(folder, method, pairs), density)[:4]
            times = [float(np.median(each[begin:])) for each in (method.after_s, method.right_look_s)]
            numbers[name].append([*found, *(1e3 * each for each in times)])
        for name, rows in numbers.items():
            yield _cells(folder.name, name, rows[-1])
    for name, rows in numbers.items():
        yield _cells("mean", name, np.mean(rows, axis=0).tolist())


def _cells(scene: str, name: str, numbers: Sequence[float]) -> list[str]:
    formats = ("{:.1f}", "{:.2f}", "{:.2f}", "{:.3f}", "{:.0f}", "{:.0f}")
    return [scene, name, *(f.format(x) for f, x in zip(formats, numbers, strict=True))]


if __name__ == "__main__":
    command(main)
