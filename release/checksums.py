"""SHA256SUMS, in the format of ``sha256sum --check``."""

import hashlib
from collections.abc import Mapping


def sha256sums(files: Mapping[str, bytes]) -> str:
    """A line for each file, by name: its SHA-256, two spaces, its name."""
    return "".join(f"{hashlib.sha256(files[name]).hexdigest()}  {name}\n" for name in sorted(files))
