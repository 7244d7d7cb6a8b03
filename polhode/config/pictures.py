"""Settings of the pictures that a run leaves beside its numbers."""

from pydantic import Field

from polhode.config.section import Section


class Pictures(Section):
    """Pictures of the map and of the model, in RUN/pictures."""

    views: bool = True
    """Landmarks from six sides, contact sheet of the mesh."""
    animation: bool = True
    """The model beside the camera's images with their difference, as MP4 and GIF."""
    frames: int = Field(60, ge=1)
    """Most frames of the animation, spread evenly over the sequence."""
