"""The software bill of materials, in CycloneDX's JSON.

    python -m lab.release.bill_of_materials dist/polhode.cdx.json

It holds polhode with its version, every package that a run needs, as installed in this environment, with
version, licence and what it needs itself, and what is shipped besides code, the weights and the sample, with
their SHA-256. Tools for development are not part of it. It has no date, and its serial number follows from
its content: the same environment gives the same bytes.
"""

import argparse
import hashlib
import json
import sys
import tomllib
from collections.abc import Iterable, Iterator
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
from packaging.utils import canonicalize_name

from polhode.files.atomic import write_text
from polhode.runtime.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
WEIGHTS, SAMPLE = Path("frontend/weights"), Path("examples/sample")
MAX_LICENCE_LENGTH = 100
"""Longer fields hold the text of a licence instead of its name."""


def needed_here(requirements: Iterable[str], extras: Iterable[str] = ()) -> Iterator[Requirement]:
    """Those whose markers hold on this machine, with these extras."""
    for requirement in map(Requirement, requirements):
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            yield requirement


def installed_packages(requirements: Iterable[str]) -> dict[str, tuple[Distribution, set[str]]]:
    """What the requirements need here, directly and indirectly: name -> distribution, names that it needs.

    Raises InputError: one is not installed.
    """
    found: dict[str, tuple[Distribution, set[str]]] = {}
    waiting, done = list(needed_here(requirements)), set()
    while waiting:
        needed = waiting.pop()
        name, extras = canonicalize_name(needed.name), frozenset(needed.extras)
        if (name, extras) in done:
            continue
        done.add((name, extras))
        try:
            installed = distribution(name)
        except PackageNotFoundError:
            raise InputError(f"{name} is not installed in {sys.prefix}: run 'make setup' first") from None
        needs = list(needed_here(installed.requires or [], extras))
        found.setdefault(name, (installed, set()))[1].update(canonicalize_name(each.name) for each in needs)
        waiting += needs
    return dict(sorted(found.items()))


def licences(installed: Distribution) -> list[License]:
    """What the distribution declares: its SPDX expression, its licence, or its classifiers."""
    make, declared = LicenseFactory(), LicenseAcknowledgement.DECLARED
    for field in ("License-Expression", "License"):
        text = " ".join(str((installed.metadata.get_all(field) or [""])[0]).split())
        if text and text != "UNKNOWN" and len(text) <= MAX_LICENCE_LENGTH:
            return [make.make_from_string(text, license_acknowledgement=declared)]
    classifiers = (str(each) for each in installed.metadata.get_all("Classifier") or [])
    names = sorted({each.rpartition(" :: ")[2] for each in classifiers if each.startswith("License ::")})
    return [make.make_with_name(name, acknowledgement=declared) for name in names]


def package_component(installed: Distribution) -> Component:
    """An installed package."""
    name, version = installed.metadata["Name"], installed.version
    url = PackageURL("pypi", None, canonicalize_name(name), version)
    return Component(
        type=ComponentType.LIBRARY,
        name=name,
        version=version,
        bom_ref=str(url),
        purl=url,
        licenses=licences(installed),
        description=str((installed.metadata.get_all("Summary") or [""])[0]) or None,
    )


def shipped_components(version: str) -> list[Component]:
    """The weights, and the sample with each of its files, with their SHA-256."""

    def component(path: Path, kind: ComponentType, parts: Iterable[Component] = ()) -> Component:
        name = path.as_posix()
        hashes = []
        if (ROOT / path).is_file():
            digest = hashlib.sha256((ROOT / path).read_bytes()).hexdigest()
            hashes.append(HashType(alg=HashAlgorithm.SHA_256, content=digest))
        return Component(type=kind, name=name, bom_ref=name, hashes=hashes, components=parts)

    weights = [path.relative_to(ROOT) for path in sorted((ROOT / WEIGHTS).glob("*.safetensors"))]
    files = (path.relative_to(ROOT) for path in sorted((ROOT / SAMPLE).rglob("*")) if path.is_file())
    shipped = [component(path, ComponentType.MACHINE_LEARNING_MODEL) for path in weights]
    shipped.append(
        component(SAMPLE, ComponentType.DATA, [component(path, ComponentType.FILE) for path in files])
    )
    for each in shipped:
        each.version = version
        each.licenses.add(LicenseFactory().make_from_string("Apache-2.0"))
    return shipped


def bill_of_materials() -> Bom:
    """The bill of this checkout in this environment. Raises InputError: something is not installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    packages = installed_packages(project["dependencies"])
    components = {name: package_component(installed) for name, (installed, _) in packages.items()}
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
    direct = {canonicalize_name(each.name) for each in needed_here(project["dependencies"])}
    bom.register_dependency(own, [*(components[name] for name in sorted(direct)), *shipped])
    for name, (_, needs) in packages.items():
        bom.register_dependency(components[name], [components[need] for need in sorted(needs)])
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
        text = as_json(bill_of_materials())
    except InputError as error:
        raise SystemExit(f"bill_of_materials: {error}") from None
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)
    print(path)


if __name__ == "__main__":
    main()
