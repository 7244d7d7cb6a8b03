"""What stands behind the target. In: scene, camera and pose. Out: light of every pixel.

background.py  Earth and stars together
earth.py       the Earth's disc with clouds and atmosphere
stars.py       a field of stars
"""
