"""Records are studies: the cluster within the process of the tests, as in theirs."""

from tests.studies.conftest import client, sweep_here

__all__ = ["client", "sweep_here"]
