"""The thesis's table 1.1, to its digits."""

import numpy as np
import pytest

from polhode.cli.main import main
from polhode.planning.approach.tumbling_threshold import RPM, StationKeeping, Threshold, fuel_share, threshold

Capture = pytest.CaptureFixture[str]
SPHERES = StationKeeping(0.7, 5.91, 0.22, 37.7, 300.0, 0.17 / 5.91)
ORBITAL_EXPRESS = StationKeeping(12.0, 900.0, 10.8, 235.0, 7200.0, 5.0 / 900.0)


def rpm(found: Threshold) -> tuple[float, float, float]:
    return found.by_force / RPM, found.by_fuel / RPM, found.overall / RPM


def test_table_1_1() -> None:
    assert [f"{x:.2f}" for x in rpm(threshold(SPHERES))] == ["2.20", "2.17", "2.17"]
    assert [f"{x:.4f}" for x in rpm(threshold(ORBITAL_EXPRESS))] == ["0.3020", "0.1164", "0.1164"]


def test_at_the_threshold_exactly_the_fuel_is_used() -> None:
    rate = threshold(SPHERES).by_fuel
    delta_v = rate**2 * SPHERES.radius_m * SPHERES.duration_s
    assert fuel_share(delta_v, SPHERES.isp_s) == pytest.approx(SPHERES.fuel_fraction, rel=1e-12)
    force = SPHERES.mass_kg * SPHERES.radius_m * threshold(SPHERES).by_force ** 2
    assert force == pytest.approx(SPHERES.force_n, rel=1e-12)


WORDS = ["threshold", "--radius-m", "12", "--mass-kg", "900", "--force-n", "10.8", "--isp-s", "235"]
WORDS += ["--duration-s", "7200", "--fuel-fraction", str(5.0 / 900.0)]


def test_the_command_prints_three_rates_in_both_units(capsys: Capture) -> None:
    assert main(WORDS) == 0
    rows = [line.rsplit(maxsplit=4)[1:] for line in capsys.readouterr().out.splitlines()]
    assert [(row[1], row[3]) for row in rows] == [("rad/s", "RPM")] * 3
    assert [row[2] for row in rows] == ["0.3020", "0.1164", "0.1164"]
    np.testing.assert_allclose([float(row[0]) / RPM for row in rows], [0.3020, 0.1164, 0.1164], atol=5e-5)
    words = list(WORDS)
    words[words.index("--force-n") + 1] = "1e-9"
    assert main(words) == 0
    assert "3.043e-07 rad/s  2.906e-06 RPM" in capsys.readouterr().out


OUT_OF_RANGE = "give a number from"


@pytest.mark.parametrize(
    ("option", "value", "advice"),
    [
        ("--radius-m", "0", ""),
        ("--fuel-fraction", "1", ""),
        ("--isp-s", "-3", ""),
        ("--duration-s", "inf", ""),
        # each is a number, but no rate follows from it
        ("--radius-m", "1e-320", OUT_OF_RANGE),
        ("--force-n", "1e300", OUT_OF_RANGE),
        ("--mass-kg", "1e308", OUT_OF_RANGE),
        ("--fuel-fraction", "1e-320", OUT_OF_RANGE),
    ],
)
def test_impossible_values_are_one_line(option: str, value: str, advice: str, capsys: Capture) -> None:
    words = list(WORDS)
    words[words.index(option) + 1] = value
    assert main(words) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1 and captured.out == ""
    assert f"{option} " in captured.err and advice in captured.err


def test_products_that_underflow_do_not_matter_where_the_rate_is_sound() -> None:
    found = threshold(StationKeeping(1e-200, 1e-100, 1e-300, 1e-200, 1.0, 0.5))
    assert found.by_force == pytest.approx(1.0, rel=1e-12)
    assert found.by_fuel == pytest.approx(np.sqrt(9.81 * np.log(2.0)), rel=1e-12)
