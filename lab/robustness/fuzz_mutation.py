"""Changes of an input: bytes, numbers and lines; members of archives and chunks, with right checksums."""

import io
import json
import re
import struct
import zipfile
import zlib
from random import Random
from typing import Any

from lab.robustness.fuzz_targets import NUMBERS, Target

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_INTEGERS = (0, 1, 2**7, 2**8 - 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63)
_DTYPES = b"'<f4' '<i8' '|b1' '<u2' '|O' '<U4' '>f8' '<c16' '|S8' '<m8[ns]'".split()
_SHAPES = (b"()", b"(0,)", b"(-1,)", b"(10**12,)", b"(3, 4)", b"(99999999999,)", b"(0, 99999999999)")
_FLOATS = (float("nan"), float("inf"), -1.0, 0.0, 1e308, 5e-324, -1e308)
_VALUES: tuple[Any, ...] = (0, 1, -1, 2**31, 2**63, 1e308, float("nan"), None, True, "", "x" * 300, [], {},
                            [0], 5121, 5126, "VEC2", "MAT4", 4, 5, 255)  # fmt: skip
"""For entries of JSON, among them codes of glTF"""
_PNG_CHUNKS = b"tEXt zTXt iTXt iCCP PLTE tRNS acTL fcTL fdAT eXIf gAMA IEND".split()


def mutated(target: Target, content: bytes, rng: Random) -> bytes:
    """One to four changes, most of them of the structure where the format has one."""
    structured = {"zip": _zip, "glb": _glb, "png": _png, "safetensors": _safetensors}.get(target.kind)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 4))):
        try:
            change = structured if structured is not None and rng.random() < 0.7 else _plain
            content = change(target, content, rng)
        except Exception:  # noqa: BLE001  an earlier change has broken the structure
            content = _plain(target, content, rng)
    return content


def _plain(target: Target, content: bytes, rng: Random) -> bytes:
    """Bytes changed, removed, inserted or repeated; of text also numbers and lines."""
    word = rng.choice(target.words or NUMBERS)
    if not content:
        return word
    at = rng.randrange(len(content))
    before, after = content[:at], content[at:]
    text = target.kind == "text" or rng.random() < 0.2
    match rng.randrange(10 if text else 6):
        case 0:
            return before + bytes([after[0] ^ (1 << rng.randrange(8))]) + after[1:]
        case 1:
            return before + rng.randbytes(1) + after[1:]
        case 2:
            return before + after[rng.choice((1, 2, 4, 16, 200)) :]
        case 3:
            return before + after[: rng.choice((1, 4, 16, 200, 4000))] * rng.choice((2, 3, 50)) + after
        case 4:
            size = rng.choice((1, 2, 4, 8))
            value = rng.choice(_INTEGERS) % 2 ** (8 * size)
            return before + value.to_bytes(size, rng.choice(("little", "big"))) + after[size:]
        case 5 | 6:
            return before + word + after[rng.choice((0, 0, 1, 4)) :]
        case 7 | 8 if numbers := list(_NUMBER.finditer(content)):
            found = rng.choice(numbers)
            return content[: found.start()] + rng.choice(NUMBERS) + content[found.end() :]
    lines = content.split(b"\n")
    at = rng.randrange(len(lines))
    return b"\n".join([*lines[:at], *[rng.choice(lines)] * rng.choice((1, 1, 30)), *lines[at:]])


def _zip(target: Target, content: bytes, rng: Random) -> bytes:
    """A member changed, removed, renamed or cut; checksums are right again."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    i = rng.randrange(len(members))
    name, member = members[i]
    match rng.randrange(6):
        case 0:
            members.pop(i)
        case 1:
            members[i] = (rng.choice((members[0][0], "../" + name, "x.npy", "", name.upper())), member)
        case 2:
            members[i] = (name, rng.choice(members)[1][: rng.randrange(len(member) + 1)])
        case 3 | 4:
            members[i] = (name, _npy(member, rng))
        case _:
            members[i] = (name, _plain(target, member, rng))
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, member in dict(members).items():
            archive.writestr(name, member)
    return stream.getvalue()


def _npy(member: bytes, rng: Random) -> bytes:
    """Another dtype, shape or values behind a header that may fit."""
    (size,) = struct.unpack_from("<H", member, 8)
    header, body = member[10 : 10 + size], bytearray(member[10 + size :])
    match rng.randrange(3):
        case 0:
            header = re.sub(rb"'[<>|=][a-zA-Z]\d*(\[ns\])?'", rng.choice(_DTYPES), header, count=1)
        case 1:
            header = re.sub(rb"\([^)]*\)", rng.choice(_SHAPES), header, count=1)
        case _ if len(body) >= 8:
            for _ in range(rng.choice((1, 1, 10))):
                raw = struct.pack("<d", rng.choice(_FLOATS)) if rng.random() < 0.6 else rng.randbytes(8)
                at = 8 * rng.randrange(len(body) // 8)
                body[at : at + 8] = raw
    return member[:8] + struct.pack("<H", len(header)) + header + bytes(body)


def _glb(target: Target, content: bytes, rng: Random) -> bytes:
    """The description or the chunk behind it changed, the lengths of the chunks corrected."""
    (size,) = struct.unpack_from("<I", content, 12)
    text, rest = content[20 : 20 + size], content[20 + size :]
    text = _json(text, rng) if rng.random() < 0.6 else _plain(target, text, rng)
    if rng.random() < 0.3 and len(rest) > 8:
        body = _plain(target, rest[8:], rng)
        rest = struct.pack("<2I", len(body), 0x4E4942) + body
    text += b" " * (-len(text) % 4)
    return content[:8] + struct.pack("<3I", 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


def _json(text: bytes, rng: Random) -> bytes:
    """A value anywhere in a document replaced, removed or repeated."""
    document = below = json.loads(text)
    while isinstance(below, dict | list) and below:
        inside, key = below, rng.choice(list(below) if isinstance(below, dict) else range(len(below)))
        below = inside[key]
        if isinstance(below, dict | list) and below and rng.random() < 0.8:
            continue
        match rng.randrange(4):
            case 0:
                del inside[key]
            case 1 if isinstance(inside, list):
                inside.extend([below] * rng.choice((1, 30)))
            case _:
                inside[key] = rng.choice(_VALUES)
        break
    return json.dumps(document).encode()


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
    match rng.randrange(5):
        case 0:
            chunks.insert(rng.randrange(len(chunks)), chunks[i])
        case 1:
            packed = b"key\0\0" + zlib.compress(bytes(rng.choice((10, 10**5, 3 * 10**6))))
            chunks.insert(i + 1, (rng.choice(_PNG_CHUNKS), rng.choice((body[:256], packed, b""))))
        case 2 if kind == b"IDAT":
            chunks[i] = (kind, zlib.compress(_plain(target, zlib.decompress(body), rng)))
        case _:
            chunks[i] = (kind, _plain(target, body, rng))
    packed = b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )
    return content[:8] + packed


def _safetensors(target: Target, content: bytes, rng: Random) -> bytes:
    """The header changed, its length corrected."""
    (size,) = struct.unpack_from("<Q", content)
    text = _json(content[8 : 8 + size], rng)
    return struct.pack("<Q", len(text)) + text + content[8 + size :]
