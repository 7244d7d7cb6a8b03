"""What lights the target, and what stands behind it."""

from polhode.config.section import NonNegative, Positive, Section, Vector3


class Eclipse(Section):
    """The Earth's shadow: no Sun, and a dark Earth."""

    start_s: NonNegative = 10.0
    """First moment without direct sunlight, after the first frame [s]."""
    duration_s: NonNegative = 0.0
    """How long the darkness lasts [s]; 0: no eclipse."""
    ramp_s: NonNegative = 1.0
    """Length of the fading before and after it, through the penumbra [s]."""


class Light(Section):
    """What lights the target. Intensities are reflected levels of a white surface that faces the light."""

    sun_direction_N: Vector3 = (0.55, -0.5, -0.7)
    """From the target towards the Sun, in N; any length."""
    sun: NonNegative = 1.0
    """Sunlight; 1 brings a white surface to ``white_dn``."""
    sun_diameter_deg: NonNegative = 0.533
    """Angular diameter: softens the shadows' edges; 0: a point [deg]."""
    earth_direction_N: Vector3 = (-0.3, 0.9, 0.2)
    """From the target towards the middle of the Earth, which fills the shadows."""
    earth: NonNegative = 0.15
    """Radiance of the Earth's disc relative to a white surface in sunlight."""
    earth_radius_deg: Positive = 66.0
    """Angular radius of the Earth's disc: 66 degrees at 600 km [deg]."""
    lamp: NonNegative = 0.0
    """Inspector's lamp beside the left camera: its light at 1 m, relative to sunlight."""
    lamp_position_m: Vector3 = (0.045, -0.06, 0.0)
    """The lamp in the left camera's frame [m]."""
    eclipse: Eclipse = Eclipse()


class Background(Section):
    """What is seen behind the target; black sky when nothing is asked for."""

    stars: bool = False
    """Stars, fixed in N, random by the scene's seed."""
    star_dn: Positive = 200.0
    """Grey value, in its brightest pixel, of a star of magnitude 0 [DN]."""
    faintest_magnitude: float = 6.5
    """Stars fainter than this are left out; there are about 9000 over the sky to magnitude 6.5."""
    earth: bool = False
    """The Earth's disc with clouds and a thin bright limb, where ``light.earth_direction_N`` says."""
