"""checkout.json: its content as pydantic models, and its JSON Schema.

``checkout.schema.json``, beside this file, is generated from the models
(``python -m polhode.pipeline.checkout.result``) and shipped.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from pydantic import Field

from polhode.files.atomic import write_text
from polhode.run_directory.summary_schema import Finite, StrictModel, Variance, json_schema

SCHEMA_FILE = Path(__file__).with_name("checkout.schema.json")
Verdict = Literal["PASS", "WARN", "FAIL"]
Group = Literal["rig", "range", "motion", "images", "time", "background", "inspector"]


class CheckoutCheck(StrictModel):
    """One check of the data before a run."""

    group: Group
    name: str
    value: Finite | None
    """null: these data do not allow the check, for the reason in ``finding``."""
    unit: str
    limit: Finite | None
    """Beyond it (``at_least``: below it) the check warns; null: information only."""
    fail_limit: Finite | None = None
    """Beyond it the check fails; null: it never fails."""
    at_least: bool = False
    """Whether values below the limits are bad, not those above."""
    sigma: Variance = None
    """Standard deviation of the value, in its unit; null: not known."""
    status: Verdict
    finding: str
    """What was found, a sentence."""
    advice: str
    """What to do, a sentence."""


class CheckoutResult(StrictModel):
    """The content of checkout.json."""

    schema_: Literal["polhode-checkout/1"] = Field("polhode-checkout/1", alias="schema")
    status: Verdict
    """The worst of the checks."""
    pairs: int = Field(ge=0)
    """Usable stereo pairs of the sequence."""
    pairs_examined: int = Field(ge=0)
    """Pairs whose images were looked at, spread over the sequence."""
    rig: Literal["sequence", "given"]
    """Whose calibration was checked: that of the sequence, or another one (--rig)."""
    checks: tuple[CheckoutCheck, ...]

    def named(self, name: str) -> CheckoutCheck:
        """The check of this name. Raises KeyError."""
        return {check.name: check for check in self.checks}[name]


def worst(checks: Iterable[CheckoutCheck]) -> Verdict:
    """The status of all together."""
    found = {check.status for check in checks}
    return "FAIL" if "FAIL" in found else "WARN" if "WARN" in found else "PASS"


if __name__ == "__main__":
    write_text(SCHEMA_FILE, json.dumps(json_schema(CheckoutResult), indent=2) + "\n")
