"""What decides, besides its input, which bytes a run has: the program, its libraries, the processor."""

import hashlib
import os
import platform
from collections.abc import Collection
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
LIBRARIES = (
    *("casadi", "embreex", "kornia", "numba", "numpy", "opencv-python-headless", "pydantic"),
    *("scikit-image", "scipy", "torch", "trimesh"),
)
"""Those that compute something; the peers among them need not be installed."""
_OWN = (".py", ".safetensors")
_CPU = Path("/proc/cpuinfo")


@cache
def program_digest() -> str:
    """SHA-256, hexadecimal, of the code and weights of this package, the versions of its libraries, and the
    processor's name: libraries choose their loops, and so the last digits, by it."""
    words = f"{code_digest()} {platform.machine()} {processor()}"
    return hashlib.sha256(words.encode()).hexdigest()


@cache
def code_digest() -> str:
    """The same without the processor: equal on all machines of a cluster with the same installation."""
    digest = hashlib.sha256()
    for folder, folders, files in os.walk(PACKAGE, followlinks=True):
        folders[:] = sorted(name for name in folders if not name.startswith(("_", ".")))
        for name in sorted(files):
            if name.endswith(_OWN):
                file = Path(folder) / name
                digest.update(f"{file.relative_to(PACKAGE)} {file.stat().st_size};".encode())
                digest.update(file.read_bytes())
    digest.update(f"{versions_of(LIBRARIES)}{platform.python_version()}".encode())
    return digest.hexdigest()


def versions_of(libraries: Collection[str]) -> str:
    """Names and versions of packages; of one that is not installed, its name alone."""
    found = {}
    for library in libraries:
        with suppress(PackageNotFoundError):
            found[library] = version(library)
    return "".join(f"{library} {found.get(library, '')};" for library in libraries)


def processor() -> str:
    """The processor's name."""
    try:
        lines = _CPU.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith("model name")), "")
