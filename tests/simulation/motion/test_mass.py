"""Mass properties: densities of parts add up, what is set by hand stands, principal axes are sorted."""

from pathlib import Path

import numpy as np
import pytest

from polhode.config import scene_settings as config
from polhode.config.loader import load_config
from polhode.runtime.errors import InputError
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.motion.mass import mass_distribution, principal_axes

TS38 = Path(__file__).parents[3] / "configs" / "ts38.yaml"


@pytest.fixture(scope="module")
def body() -> Body:
    return build_body(config.TargetBody(), 0)


def test_densities_and_mass_give_the_mass_properties(body: Body) -> None:
    mass = mass_distribution(config.Mass(density_kg_m3=500.0), body)
    assert mass.mass_kg == pytest.approx(500.0 * body.volume_m3)
    np.testing.assert_allclose(mass.com_G, body.com_G, atol=1e-15)
    np.testing.assert_allclose(mass.J_G, 500.0 * body.inertia_per_density, atol=1e-12)
    by_density = mass_distribution(config.Mass(part_density_kg_m3={"tank": 4000.0}), body)
    by_hand = mass_distribution(config.Mass(part_density_kg_m3={"tank": 4000.0}, mass_kg=4.487), body)
    assert by_hand.mass_kg == pytest.approx(4.487)
    np.testing.assert_allclose(by_hand.J_G, by_density.J_G * 4.487 / by_density.mass_kg, rtol=1e-12)
    np.testing.assert_allclose(by_hand.com_G, by_density.com_G, atol=1e-15)
    inertia = ((3e-2, 1e-4, 0.0), (1e-4, 2e-2, 0.0), (0.0, 0.0, 2.5e-2))
    mass = mass_distribution(config.Mass(com_m=(1e-3, 2e-3, 3e-3), inertia_kg_m2=inertia, mass_kg=7.0), body)
    np.testing.assert_array_equal(mass.com_G, [1e-3, 2e-3, 3e-3])
    np.testing.assert_array_equal(mass.J_G, inertia)
    assert mass.mass_kg == pytest.approx(7.0)


def test_a_part_of_its_own_density_adds_its_own_mass(body: Body) -> None:
    """The tank made 5000 kg/m^3 denser: mass, first and second moments grow by those of the tank alone."""
    (tank,) = [part for part in body.parts if part.name == "tank"]
    density = 1000.0 * tank.density_factor
    light = mass_distribution(config.Mass(part_density_kg_m3={"tank": density}), body)
    heavy = mass_distribution(config.Mass(part_density_kg_m3={"tank": density + 5000.0}), body)
    np.testing.assert_allclose(light.J_G, mass_distribution(config.Mass(), body).J_G, rtol=1e-12)
    added_kg = 5000.0 * tank.volume_m3
    assert heavy.mass_kg - light.mass_kg == pytest.approx(added_kg)
    first = heavy.mass_kg * heavy.com_G - light.mass_kg * light.com_G
    np.testing.assert_allclose(first, added_kg * tank.com_G, atol=1e-15)
    second = _about_origin(heavy.J_G, heavy.mass_kg, heavy.com_G) - _about_origin(
        light.J_G, light.mass_kg, light.com_G
    )
    expected = _about_origin(5000.0 * tank.inertia_per_density, added_kg, tank.com_G)
    np.testing.assert_allclose(second, expected, atol=1e-15)


def _about_origin(J_G: np.ndarray, mass_kg: float, com_G: np.ndarray) -> np.ndarray:
    return np.asarray(J_G + mass_kg * (com_G @ com_G * np.eye(3) - np.outer(com_G, com_G)))


def test_an_unknown_part_and_an_impossible_inertia_are_refused(body: Body) -> None:
    with pytest.raises(InputError, match=r"part_density_kg_m3: the body has no part 'wing', only .*tank"):
        mass_distribution(config.Mass(part_density_kg_m3={"wing": 1.0}), body)
    mass = config.Mass(com_m=(0, 0, 0), inertia_kg_m2=((3, 0, 0), (0, 1, 0), (0, 0, 1)))
    with pytest.raises(InputError, match="no body has the principal moments 1, 1, 3"):
        mass_distribution(mass, body)
    mass = config.Mass(inertia_kg_m2=((3, 0.1, 0), (0, 2, 0), (0, 0, 2)))
    with pytest.raises(InputError, match="not symmetric"):
        mass_distribution(mass, body)


def test_the_thesis_inertia_gives_its_published_principal_axes(body: Body) -> None:
    scene = load_config(TS38).scene
    assert scene is not None
    mass = mass_distribution(scene.mass, body)
    np.testing.assert_allclose(mass.moments, [0.0241, 0.0234, 0.0201], atol=5e-5)
    published = np.array([[0.9833, 0.1787, 0.0349], [-0.1783, 0.9838, -0.0160], [-0.0372, 0.0095, 0.9993]])
    np.testing.assert_allclose(mass.R_GP, published, atol=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_principal_axes_are_sorted_and_right_handed(seed: int) -> None:
    A = np.random.default_rng(seed).normal(size=(3, 3))
    J = A @ A.T
    moments, R = principal_axes(J)
    assert moments[0] >= moments[1] >= moments[2]
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R @ np.diag(moments) @ R.T, J, atol=1e-12)
