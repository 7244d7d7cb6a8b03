"""The software bill of materials, in CycloneDX's JSON.

    python -m release.bill_of_materials dist/polhode.cdx.json

It holds polhode with its version, every package that a run needs, as installed in this environment, with
version, licence and what it needs itself, and what is shipped besides code, the weights and the sample, with
their SHA-256. Tools for development are not part of it. It has no date, and its serial number follows from
its content: the same environment gives the same bytes.
"""

import argparse
import hashlib
import json
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.model.license import License, LicenseAcknowledgement
from cyclonedx.output.json import JsonV1Dot6
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packageurl import PackageURL
from packaging.requirements import Requirement

from polhode.atomic import write_text
from polhode.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
WEIGHTS, SAMPLE = Path("frontend/weights"), Path("sample")
MAX_LICENCE_LENGTH = 100
"""Longer fields hold the text of a licence instead of its name."""


@dataclass(frozen=True)
class Package:
    """An installed distribution and the normalised names of those that it needs here."""

    installed: Distribution
    needs: frozenset[str]


def installed_packages(requirements: Iterable[str]) -> dict[str, Package]:
    """What the requirements need in this environment, directly and indirectly, by normalised name.

    Raises InputError: one is not installed.
    """
    found: dict[str, Package] = {}
    waiting = [(normalised(needed.name), frozenset(needed.extras)) for needed in needed_here(requirements)]
    done: set[tuple[str, frozenset[str]]] = set()
    while waiting:
        name, extras = waiting.pop()
        if (name, extras) in done:
            continue
        done.add((name, extras))
        try:
            installed = distribution(name)
        except PackageNotFoundError:
            raise InputError(f"{name} is not installed in {sys.prefix}: run 'make setup' first") from None
        needs = list(needed_here(installed.requires or [], extras))
        former = found[name].needs if name in found else frozenset()
        found[name] = Package(installed, former | {normalised(each.name) for each in needs})
        waiting += [(normalised(each.name), frozenset(each.extras)) for each in needs]
    return dict(sorted(found.items()))


def needed_here(requirements: Iterable[str], extras: Iterable[str] = ()) -> Iterator[Requirement]:
    """Those whose markers hold on this machine, with these extras."""
    for text in requirements:
        requirement, marker = Requirement(text), Requirement(text).marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            yield requirement


def normalised(name: str) -> str:
    """The name of a distribution as PyPI compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _field(installed: Distribution, name: str) -> str | None:
    """The first of this name that a distribution's metadata has."""
    found = installed.metadata.get_all(name)
    return str(found[0]) if found else None


def licences(installed: Distribution) -> list[License]:
    """What the distribution declares: its SPDX expression, its licence, or its classifiers."""
    make, declared = LicenseFactory(), LicenseAcknowledgement.DECLARED
    for field in ("License-Expression", "License"):
        text = " ".join(str(_field(installed, field) or "").split())
        if text and text != "UNKNOWN" and len(text) <= MAX_LICENCE_LENGTH:
            return [make.make_from_string(text, license_acknowledgement=declared)]
    classifiers = (str(each) for each in installed.metadata.get_all("Classifier") or [])
    names = sorted({each.rpartition(" :: ")[2] for each in classifiers if each.startswith("License ::")})
    return [make.make_with_name(name, acknowledgement=declared) for name in names]


def component_of(package: Package) -> Component:
    """An installed package."""
    name, version = package.installed.metadata["Name"], package.installed.version
    url = PackageURL("pypi", None, normalised(name), version)
    return Component(
        type=ComponentType.LIBRARY,
        name=name,
        version=version,
        bom_ref=str(url),
        purl=url,
        licenses=licences(package.installed),
        description=_field(package.installed, "Summary"),
    )


def file_component(path: Path, kind: ComponentType = ComponentType.FILE) -> Component:
    """A shipped file with its SHA-256; ``path`` is relative to the repository."""
    digest = hashlib.sha256((ROOT / path).read_bytes()).hexdigest()
    return Component(
        type=kind,
        name=path.as_posix(),
        bom_ref=path.as_posix(),
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest)],
    )


def shipped_components(version: str) -> list[Component]:
    """The weights, and the sample with each of its files."""
    weights = [
        file_component(path.relative_to(ROOT), ComponentType.MACHINE_LEARNING_MODEL)
        for path in sorted((ROOT / WEIGHTS).glob("*.safetensors"))
    ]
    files = sorted(path.relative_to(ROOT) for path in (ROOT / SAMPLE).rglob("*") if path.is_file())
    sample = Component(
        type=ComponentType.DATA,
        name=SAMPLE.as_posix(),
        bom_ref=SAMPLE.as_posix(),
        components=[file_component(path) for path in files],
    )
    own = LicenseFactory().make_from_string("Apache-2.0")
    for each in (*weights, sample):
        each.version = version
        each.licenses.add(own)
    return [*weights, sample]


def bill_of_materials() -> Bom:
    """The bill of this checkout in this environment. Raises InputError: something is not installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    packages = installed_packages(project["dependencies"])
    components = {name: component_of(package) for name, package in packages.items()}
    own = Component(
        type=ComponentType.APPLICATION,
        name=project["name"],
        version=project["version"],
        bom_ref=project["name"],
        description=project["description"],
        licenses=[LicenseFactory().make_from_string(project["license"])],
    )
    shipped = shipped_components(project["version"])
    bom = Bom(components=[*components.values(), *shipped])
    bom.metadata.component = own
    direct = {normalised(each.name) for each in needed_here(project["dependencies"])}
    bom.register_dependency(own, [*(components[name] for name in sorted(direct)), *shipped])
    for name, package in packages.items():
        bom.register_dependency(components[name], [components[need] for need in sorted(package.needs)])
    return bom


def as_json(bom: Bom) -> str:
    """CycloneDX 1.6 without a date, checked against its schema. Raises ValueError: it does not fit it."""
    content = json.loads(JsonV1Dot6(bom).output_as_string())
    del content["metadata"]["timestamp"], content["serialNumber"]
    content["serialNumber"] = uuid5(NAMESPACE_URL, json.dumps(content, sort_keys=True)).urn
    text = json.dumps(content, indent=2, sort_keys=True) + "\n"
    fault = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    if fault is not None:
        raise ValueError(f"not valid CycloneDX: {str(fault).splitlines()[0]}")
    return text


def main(arguments: list[str] | None = None) -> None:
    """Write the bill of materials."""
    parser = argparse.ArgumentParser(description="Write the software bill of materials.")
    parser.add_argument("file", type=Path, help="where to, for example dist/polhode.cdx.json")
    path: Path = parser.parse_args(arguments).file
    try:
        bom = bill_of_materials()
    except InputError as error:
        raise SystemExit(f"bill_of_materials: {error}") from None
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, as_json(bom))
    print(f"{path}: {len(bom.components)} components")


if __name__ == "__main__":
    main()
