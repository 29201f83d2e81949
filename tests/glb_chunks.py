"""GLB files as their two chunks."""

import json
import struct


def glb_chunks(content: bytes) -> tuple[dict, bytes]:
    """The JSON of a GLB and its binary chunk."""
    length = struct.unpack("<I", content[12:16])[0]
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def glb_of(tree: dict, binary: bytes) -> bytes:
    """The GLB of both."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks
