"""The whole loop on images: inspect, make the edge model from the run's own mesh, approach, track, arrive.

    python -m lab.navigation.inspect_and_approach [--short] [--stored] [--record DIR]

An inspector watches a tumbling body (``polhode.run`` on rendered pairs). The edges of the run's mesh, moved
to where the images have them, are its model, the end of the run its first state. It plans an approach with
the metric, and a filter promises a covariance on arrival before there is an image. Then it flies: images of
the true body are rendered, tracked from the filter's own prediction, and filtered. The errors on arrival
are compared with what was promised.

There are three inspections of each body and seven flights after each. Sizes of the edges' errors, and what
stretches the promise, come from the flights to the other bodies: at least two are needed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.stats import beta, chi2
from tyro.conf import arg

from lab.command import Record, Short, Workers, command
from lab.navigation.approach_flights import IMAGES, FlightMeasurement, Weights, from_line
from lab.navigation.arrivals import (
    ATTITUDE,
    CONFIDENCE,
    POSITION,
    RATE,
    Arrival,
    arrival,
    fitted_sizes,
    promise,
    squared_distance,
    stretch,
    without_unobserved,
)
from lab.navigation.inspections import FAMILIES
from lab.presentation import print_table
from lab.record import Case, complete, measured
from polhode.geometry.lie import Array
from polhode.runtime.errors import InputError

RECORD = Path("runs/records/inspect_and_approach")
SEEDS, SHORT_SEEDS, SHORT_BODIES = 21, 3, 2
FLIGHTS = 7
"""After each inspection"""
PARTS = {"position": POSITION, "attitude": ATTITUDE, "rate": RATE}


def inspections_beside(record: Path) -> Path:
    """Folder of the inspections of a record."""
    return record.with_name(f"{record.name}_inspections")


def cases(bodies: Sequence[str], seeds: int) -> list[Case]:
    """A flight each; those of all bodies come by turns, ``FLIGHTS`` after each inspection."""
    return [
        {"body": body, "inspection": 1 + (seed - 1) // FLIGHTS, "seed": seed}
        for seed in range(1, seeds + 1)
        for body in bodies
    ]


def main(
    short: Short = False,
    workers: Workers = 1,
    record: Record = RECORD,
    stored: Annotated[bool, arg(help="Only print what was measured before.")] = False,
) -> None:
    """Fly what the record lacks; print the tables. The inspections are kept beside the record."""
    wanted = cases(FAMILIES[:SHORT_BODIES], SHORT_SEEDS) if short else cases(FAMILIES, SEEDS)
    fly = FlightMeasurement(inspections_beside(record))
    lines = measured(record, wanted) if stored else complete(record, wanted, fly, workers)
    judged = _judged({body: [line for line in lines if line["case"]["body"] == body] for body in FAMILIES})
    if not judged:
        raise InputError("the record has flights to fewer than two bodies: one body's sizes come from others")
    _print(judged, lines)


@dataclass(frozen=True)
class Judged:
    """A flight, what was promised, and how it arrived."""

    body: str
    inspection: int
    seed: int
    weights: Weights
    """from the flights to other bodies"""
    factor: Array
    """(12,) of the promised sigmas, from those flights, too"""
    promised: Array
    """(12, 12) with the factor"""
    arrival: Arrival

    def nees(self, part: slice, covariance: Array) -> float:
        """Squared error of a part over its covariance, per degree of freedom."""
        return squared_distance(self.arrival.error, covariance, part) / (part.stop - part.start)

    def inside(self, part: slice, covariance: Array) -> bool:
        """Whether the error lies within the 95 % region."""
        freedom = part.stop - part.start
        return bool(self.nees(part, covariance) * freedom <= chi2.ppf(CONFIDENCE, freedom))


def _judged(lines: dict[str, list[Case]]) -> list[Judged]:
    flights = {
        body: {
            (line["case"]["inspection"], line["case"]["seed"]): without_unobserved(from_line(line))
            for line in group
            if "no_flight" not in line
        }
        for body, group in lines.items()
    }
    flights = {body: group for body, group in flights.items() if group}
    if len(flights) < 2:
        return []
    out = []
    for body, group in flights.items():
        others = [flight for name, each in flights.items() if name != body for flight in each.values()]
        found, expected = fitted_sizes(others, expected=False), fitted_sizes(others, expected=True)
        arrived = [arrival(each, each.found, found) for each in others]
        factor = stretch(arrived, [promise(each, expected) for each in others])
        for (inspection, seed), flight in group.items():
            out.append(
                Judged(
                    body,
                    inspection,
                    seed,
                    found,
                    factor,
                    np.outer(factor, factor) * promise(flight, expected),
                    arrival(flight, flight.found, found),
                )
            )
    return out


def _print(judged: Sequence[Judged], lines: Sequence[Case]) -> None:
    groups = {body: [each for each in judged if each.body == body] for body in {j.body: 0 for j in judged}}
    groups["all"] = list(judged)
    print("Errors on arrival within the promised 95 % region: share, interval of 95 %\n")
    columns = [f"{part}: {what}" for part in PARTS for what in ("inside", "NEES")]
    numbers = sorted({each.inspection for each in judged})
    by_number = {f"inspection {n}": [each for each in judged if each.inspection == n] for n in numbers}
    rows = ([name, str(len(group)), *_shares(group)] for name, group in (groups | by_number).items())
    print_table(" | ".join(["body", "flights", *columns, "all twelve: inside"]), rows, right_from=1)
    print("\nMedian errors, beside the promised and the filter's own sigma\n")
    columns = ["position [mm]", "promised, own", "attitude [deg]", "promised, own", "rate [deg/s]"]
    columns += ["promised, own", f"poses taken of {IMAGES}", "edges, outward", "promise stretched by"]
    rows = ([name, str(len(group)), *_sizes(group)] for name, group in groups.items())
    print_table(" | ".join(["body", "flights", *columns]), rows, right_from=1)
    print()
    for line in lines:
        if "no_flight" in line:
            print(f"{line['case']['body']} {line['case']['seed']}: no flight, {line['no_flight']}")


def _shares(group: Sequence[Judged]) -> Iterator[str]:
    for part in PARTS.values():
        yield _share([each.inside(part, each.promised) for each in group])
        yield f"{np.mean([each.nees(part, each.promised) for each in group]):.2f}"
    yield _share([each.inside(slice(0, 12), each.promised) for each in group])


def _share(inside: Sequence[bool]) -> str:
    """With the interval of Clopper and Pearson."""
    count, of = sum(inside), len(inside)
    low = 0.0 if count == 0 else float(beta.ppf(0.025, count, of - count + 1))
    high = 1.0 if count == of else float(beta.ppf(0.975, count + 1, of - count))
    return f"{count / of:.0%} ({low:.0%} to {high:.0%})"


def _sizes(group: Sequence[Judged]) -> Iterator[str]:
    unit = {"position": 1e3, "attitude": 180.0 / np.pi, "rate": 180.0 / np.pi}
    for name, part in PARTS.items():
        error = [np.linalg.norm(each.arrival.error[part]) for each in group]
        yield f"{unit[name] * float(np.median(error)):.3g}"
        sigmas = (
            [np.sqrt(np.trace(covariance[part, part])) for covariance in both]
            for both in zip(*((each.promised, each.arrival.covariance) for each in group), strict=True)
        )
        yield ", ".join(f"{unit[name] * float(np.median(sigma)):.3g}" for sigma in sigmas)
    yield f"{np.mean([each.arrival.taken for each in group]):.1f}"
    one = group[0] if len({each.body for each in group}) == 1 else None
    yield f"{one.weights.edges:.1f}, {one.weights.outward:.2f}" if one else ""
    yield ", ".join(f"{one.factor[part.start]:.1f}" for part in PARTS.values()) if one else ""


if __name__ == "__main__":
    command(main)
