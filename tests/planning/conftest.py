"""The run without images that predictions, plans and exports start from."""

from tests.pipeline.conftest import example, undetermined

__all__ = ["example", "undetermined"]
