"""What there is beside the target: light around it, masks, and whether it leaves the image."""

import numpy as np

from polhode.pipeline.checkout.result import CheckoutCheck, judged
from polhode.pipeline.checkout.sample import Sample

MAX_BORDER, FAIL_BORDER = 5.0, 60.0
"""Share of the image's border that is brighter than the sky [%], without masks."""
MAX_AROUND = 1.0
"""Share of the pixels beside the target that are brighter than the sky [%]."""
MAX_LEAVING = 20.0
"""Share of the images in which the target reaches the border [%]."""
MAX_DOUBTFUL = 20.0
"""Share of the pairs whose masks, found before a background that is not dark, are doubtful [%]."""
SOME_MASKS = "Give a mask for every frame (masks0/, masks1/), or for none: a frame without one is used whole."


def background_checks(sample: Sample) -> list[CheckoutCheck]:
    """Masks, brightness at the border and around the target, and targets that are cut off."""
    images = [
        (image, given)
        for pair in sample.pairs
        for image, given in zip(pair.images, pair.has_masks, strict=True)
    ]
    masked = np.array([given for _, given in images])
    border = 100.0 * np.array([image.border_bright for image, _ in images])
    around = 100.0 * np.array([image.around_bright for image, _ in images])
    touching = np.array([image.touches_border for image, _ in images])
    found = sample.doubtful_masks
    known_target = bool(masked.all()) or sample.surroundings or found is not None
    known = around[np.isfinite(around)]
    assumed = (
        "The target is taken to be what is brighter than a dark sky."
        if found is None
        else "The target is taken to be what stands before the background."
    )
    return [
        judged(
            "background",
            "images with masks, where some have one",
            100.0 * float(masked.mean()) if masked.any() else None,
            "%",
            100.0,
            at_least=True,
            advice=SOME_MASKS,
            finding=f"{int(masked.sum())} of {len(masked)} examined images have a mask."
            + ("" if masked.any() else f" {assumed}"),
        ),
        *_found_masks(sample),
        judged(
            "background",
            "border of the image that is not dark",
            float(np.median(border)),
            "%",
            None if known_target else MAX_BORDER,
            fail_limit=None if known_target else FAIL_BORDER,
            finding=f"From {border.min():.0f} to {border.max():.0f} %"
            + (
                "; masks are given or found, or dim surroundings are left out of the target."
                if known_target
                else ": a background that is not dark is taken for the target."
            ),
            advice="If it is background (Earth, a wall), give masks of the target in masks0/ and masks1/; "
            "if it is the "
            "target, keep all of it in view.",
        ),
        judged(
            "background",
            "surroundings of the target that are not dark",
            float(np.median(known)) if len(known) else None,
            "%",
            None if known_target else MAX_AROUND,
            finding=f"Up to {known.max():.2g} % of the pixels beside the target, in small spots such as "
            "stars."
            if len(known)
            else "The target fills the image.",
            advice="Stars and glints that are small do no harm; give masks if there are larger things.",
        ),
        judged(
            "background",
            "images in which the target reaches the border",
            100.0 * float(touching.mean()),
            "%",
            MAX_LEAVING,
            finding=f"{int(touching.sum())} of {len(touching)} examined images.",
            advice="Keep the whole target in the images: parts beyond the border have no shape, and a cut "
            "outline "
            "misleads masks.",
        ),
    ]


def _found_masks(sample: Sample) -> list[CheckoutCheck]:
    """Of masks that were found before a background that is not dark; nothing where there are none."""
    if sample.doubtful_masks is None:
        return []
    doubtful, count = sample.doubtful_masks
    return [
        judged(
            "background",
            f"{sample.noun} whose masks, found in the images, are doubtful",
            100.0 * doubtful / max(count, 1),
            "%",
            MAX_DOUBTFUL,
            finding=f"{doubtful} of {count} {sample.noun}, before a background that is not dark.",
            advice=f"Give masks of the target in masks0/{'' if sample.has_ranges else ' and masks1/'}.",
        )
    ]
