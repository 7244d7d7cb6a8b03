"""The software bill of materials is valid, reproducible, and lists exactly what a run needs."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedx", reason="the extra `sbom` is not installed: make sbom")

from packaging.utils import canonicalize_name

from lab.release.bill_of_materials import (
    ROOT,
    as_json,
    bill_of_materials,
    installed_packages,
    main,
    needed_here,
)
from polhode.runtime.errors import InputError

Bill = dict[str, Any]


@pytest.fixture(scope="module")
def text() -> str:
    """It is checked against the schema of CycloneDX when it is made."""
    return as_json(bill_of_materials())


@pytest.fixture(scope="module")
def bill(text: str) -> Bill:
    found: Bill = json.loads(text)
    return found


def test_the_same_environment_gives_the_same_bytes(text: str, tmp_path: Path) -> None:
    file = tmp_path / "dist" / "polhode.cdx.json"
    main([str(file)])
    assert file.read_text() == text and "timestamp" not in text


def test_it_lists_what_a_run_needs_in_tested_versions_and_no_tools(bill: Bill) -> None:
    libraries: dict[str, Bill] = {
        canonicalize_name(each["name"]): each for each in bill["components"] if each["type"] == "library"
    }
    assert {"numpy", "torch", "casadi", "numba", "llvmlite", "jinja2", "pydantic-core"} <= libraries.keys()
    assert libraries.keys().isdisjoint({"pytest", "ruff", "mypy", "gtsam", "mitsuba", "polhode"})
    assert all(each["version"] and each["purl"].startswith("pkg:pypi/") for each in libraries.values())
    assert libraries["numpy"]["licenses"]
    # where a package names no licence, none is invented
    assert sum("licenses" not in each for each in libraries.values()) <= 3
    # docs/security.md says that indirect ones are pinned, too
    pinned = {canonicalize_name(line.partition("==")[0]) for line in (ROOT / "constraints.txt").open()}
    assert libraries.keys() - pinned == set()


def test_it_states_our_own_version_and_what_depends_on_what(bill: Bill) -> None:
    own = bill["metadata"]["component"]
    assert (own["name"], own["type"], own["version"]) == ("polhode", "application", "0.1.0")
    assert own["licenses"] == [{"license": {"id": "Apache-2.0"}}]
    needs = {each["ref"]: each.get("dependsOn", []) for each in bill["dependencies"]}
    refs = {each["name"]: each["bom-ref"] for each in bill["components"]}
    assert refs["numba"] in needs[own["bom-ref"]] and refs["llvmlite"] not in needs[own["bom-ref"]]
    assert refs["llvmlite"] in needs[refs["numba"]]


def test_weights_and_sample_are_there_with_their_hashes(bill: Bill) -> None:
    shipped = [each for each in bill["components"] if each["type"] == "machine-learning-model"]
    assert [ROOT / each["name"] for each in shipped] == sorted(
        (ROOT / "frontend/weights").glob("*.safetensors")
    )
    files = [*shipped, *(each for data in bill["components"] for each in data.get("components", []))]
    assert len(files) > 100
    for each in files:
        digest = hashlib.sha256((ROOT / each["name"]).read_bytes()).hexdigest()
        assert each["hashes"] == [{"alg": "SHA-256", "content": digest}]


def test_requirements_of_other_machines_and_of_extras_are_left_out_and_missing_ones_named() -> None:
    given = ["a", "b; sys_platform == 'nowhere'", "c; extra == 'more'"]
    assert [each.name for each in needed_here(given)] == ["a"]
    assert [each.name for each in needed_here(given, ["more"])] == ["a", "c"]
    with pytest.raises(InputError, match=r"no-such-package is not installed .*: run 'make setup' first"):
        installed_packages(["no_such_package>=1"])
