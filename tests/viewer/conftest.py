"""The runs without images of tests/pipeline, and a sequence of a target at rest."""

from tests.pipeline.conftest import at_rest, example, undetermined

__all__ = ["at_rest", "example", "undetermined"]
