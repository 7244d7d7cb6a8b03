"""The runs without images of tests/pipeline."""

from tests.pipeline.conftest import example, undetermined

__all__ = ["example", "undetermined"]
