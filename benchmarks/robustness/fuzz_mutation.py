"""Changes of an input: bytes, numbers and lines; members of archives and chunks, with right checksums."""

import io
import json
import re
import struct
import zipfile
import zlib
from random import Random

from benchmarks.robustness.fuzz_targets import NUMBERS, Target

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def mutated(target: Target, content: bytes, rng: Random) -> bytes:
    """One to four changes, half of the time of the structure."""
    for _ in range(rng.choice((1, 1, 1, 2, 3, 4))):
        structured = _STRUCTURED.get(target.kind)
        try:
            if structured is not None and rng.random() < 0.7:
                content = structured(target, content, rng)
            else:
                content = _plain(target, content, rng)
        except Exception:  # noqa: BLE001  an earlier change has broken the structure
            content = _plain(target, content, rng)
    return content


def _plain(target: Target, content: bytes, rng: Random) -> bytes:
    if not content:
        return rng.choice(target.words or NUMBERS)
    at = rng.randrange(len(content))
    text = target.kind == "text" or rng.random() < 0.2
    choice = rng.randrange(10 if text else 6)
    if choice == 0:
        return content[:at] + bytes([content[at] ^ (1 << rng.randrange(8))]) + content[at + 1 :]
    if choice == 1:
        return content[:at] + bytes([rng.randrange(256)]) + content[at + 1 :]
    if choice == 2:
        return content[:at] + content[min(len(content), at + rng.choice((1, 2, 4, 16, 200))) :]
    if choice == 3:
        return content[:at] + rng.choice(target.words or NUMBERS) + content[at + rng.choice((0, 0, 1, 4)) :]
    if choice == 4:
        end = min(len(content), at + rng.choice((1, 4, 16, 200, 4000)))
        return content[:at] + content[at:end] * rng.choice((2, 2, 3, 50)) + content[end:]
    if choice == 5:
        size = rng.choice((1, 2, 4, 8))
        value = rng.choice(
            (0, 1, 2**7, 2**8 - 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63)
        ) % 2 ** (8 * size)
        return content[:at] + value.to_bytes(size, rng.choice(("little", "big"))) + content[at + size :]
    if choice in (6, 7):
        numbers = list(_NUMBER.finditer(content))
        if numbers:
            found = rng.choice(numbers)
            return content[: found.start()] + rng.choice(NUMBERS) + content[found.end() :]
    lines = content.split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    if choice == 8:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines[i:i] = [lines[j]] * rng.choice((1, 1, 30))
    return b"\n".join(lines)


def _zip(target: Target, content: bytes, rng: Random) -> bytes:
    """A member changed, removed, renamed or repeated; checksums are right again."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    i = rng.randrange(len(members))
    name, member = members[i]
    choice = rng.randrange(8)
    if choice == 0:
        members.pop(i)
    elif choice == 1:
        members[i] = (rng.choice((members[0][0], "../" + name, "x.npy", "", name.upper())), member)
    elif choice == 2:
        members[i] = (name, rng.choice(members)[1])
    elif choice == 3:
        members[i] = (name, member[: rng.randrange(len(member) + 1)])
    elif choice in (4, 5):
        members[i] = (name, _npy(member, rng))
    else:
        members[i] = (name, _plain(target, member, rng))
    stream = io.BytesIO()
    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(stream, "w", method) as archive:
        names = set()
        for name, member in members:
            if name not in names:
                archive.writestr(name, member)
                names.add(name)
    return stream.getvalue()


def _npy(member: bytes, rng: Random) -> bytes:
    """Another dtype, shape or values behind a header that may fit."""
    (size,) = struct.unpack_from("<H", member, 8)
    header, body = member[10 : 10 + size], bytearray(member[10 + size :])
    choice = rng.randrange(3)
    if choice == 0:
        kinds = (
            b"'<f4'",
            b"'<i8'",
            b"'|b1'",
            b"'<u2'",
            b"'|O'",
            b"'<U4'",
            b"'>f8'",
            b"'<c16'",
            b"'|S8'",
            b"'<m8[ns]'",
        )
        header = re.sub(rb"'[<>|=][a-zA-Z]\d*(\[ns\])?'", rng.choice(kinds), header, count=1)
    elif choice == 1:
        shapes = (
            b"()",
            b"(0,)",
            b"(1,)",
            b"(-1,)",
            b"(10**12,)",
            b"(3, 4)",
            b"(99999999999,)",
            b"(0, 99999999999)",
            b"(2, 0)",
        )
        header = re.sub(rb"\([^)]*\)", rng.choice(shapes), header, count=1)
    else:
        values = (float("nan"), float("inf"), -1.0, 0.0, 1e308, 5e-324, -1e308)
        for _ in range(rng.choice((1, 1, 10))):
            if len(body) >= 8:
                raw = struct.pack("<d", rng.choice(values)) if rng.random() < 0.6 else rng.randbytes(8)
                at = 8 * rng.randrange(len(body) // 8)
                body[at : at + 8] = raw
    return member[:8] + struct.pack("<H", len(header)) + header + bytes(body)


def _glb(target: Target, content: bytes, rng: Random) -> bytes:
    """The description changed as text or as values, the lengths of the chunks corrected."""
    (size,) = struct.unpack_from("<I", content, 12)
    text, rest = content[20 : 20 + size], content[20 + size :]
    if rng.random() < 0.6:
        document = json.loads(text)
        _change(document, rng)
        text = json.dumps(document).encode()
    else:
        text = _plain(target, text, rng)
    if rng.random() < 0.3 and len(rest) > 8:
        body = _plain(target, rest[8:], rng)
        rest = struct.pack("<2I", len(body), 0x4E4942) + body
    text += b" " * (-len(text) % 4)
    return content[:8] + struct.pack("<3I", 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


_VALUES = (
    0,
    1,
    -1,
    2**31,
    2**63,
    1e308,
    float("nan"),
    None,
    True,
    "",
    "x" * 300,
    [],
    {},
    [0],
    5121,
    5126,
    "VEC2",
    "MAT4",
    4,
    5,
    255,
)


def _change(document: object, rng: Random) -> None:
    """Replace, remove or repeat a value anywhere in a document."""
    while True:
        if isinstance(document, dict) and document:
            key = rng.choice(list(document))
        elif isinstance(document, list) and document:
            key = rng.randrange(len(document))
        else:
            return
        below = document[key]
        if isinstance(below, dict | list) and below and rng.random() < 0.8:
            document = below
            continue
        choice = rng.randrange(4)
        if choice == 0:
            del document[key]
        elif choice == 1 and isinstance(document, list):
            document.extend([below] * rng.choice((1, 30)))
        else:
            document[key] = rng.choice(_VALUES)
        return


def _png(target: Target, content: bytes, rng: Random) -> bytes:
    """Chunks of a PNG changed, repeated or exchanged, with right checksums; other formats plainly."""
    if not content.startswith(b"\x89PNG\r\n\x1a\n"):
        return _plain(target, content, rng)
    chunks, at = [], 8
    while at + 8 <= len(content):
        (size,) = struct.unpack_from(">I", content, at)
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + size]))
        at += 12 + size
    i = rng.randrange(len(chunks))
    kind, body = chunks[i]
    choice = rng.randrange(5)
    if choice == 0:
        chunks.insert(rng.randrange(len(chunks)), chunks[i])
    elif choice == 1:
        kinds = (
            b"tEXt",
            b"zTXt",
            b"iTXt",
            b"iCCP",
            b"PLTE",
            b"tRNS",
            b"acTL",
            b"fcTL",
            b"fdAT",
            b"eXIf",
            b"gAMA",
            b"IEND",
        )
        packed = b"key\0\0" + zlib.compress(bytes(rng.choice((10, 10**5, 3 * 10**6))))
        chunks.insert(
            1 + rng.randrange(len(chunks)), (rng.choice(kinds), rng.choice((body[:256], packed, b"")))
        )
    elif choice == 2 and kind == b"IDAT":
        chunks[i] = (kind, zlib.compress(_plain(target, zlib.decompress(body), rng)))
    else:
        chunks[i] = (kind, _plain(target, body, rng))
    packed = b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )
    return content[:8] + packed


def _safetensors(target: Target, content: bytes, rng: Random) -> bytes:
    """The header changed, its length corrected."""
    (size,) = struct.unpack_from("<Q", content)
    document = json.loads(content[8 : 8 + size])
    _change(document, rng)
    text = json.dumps(document).encode()
    return struct.pack("<Q", len(text)) + text + content[8 + size :]


_STRUCTURED = {"zip": _zip, "glb": _glb, "png": _png, "safetensors": _safetensors}
