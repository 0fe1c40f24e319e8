"""Bytes that attacks send: websocket frames (RFC 6455, 7692), requests of HTTP, JSON, lines of Gamebots."""

import base64
import json
import random
import struct
import zlib

CONTINUATION, TEXT, BINARY, PING = 0, 1, 2, 9
FINAL, COMPRESSED, MASKED = 0x80, 0x40, 0x80
SHORT, MEDIUM, LONG = 125, 126, 127  # RFC 6455 5.2: lengths above 125 take 2 or 8 more bytes
KEY = base64.b64encode(bytes(range(16))).decode()
SYNC = b"\x00\x00\xff\xff"  # ends a flushed block; RFC 7692 leaves it out


def websocket_frame(
    payload: bytes,
    opcode: int = TEXT,
    *,
    final: bool = True,
    masked: bool = True,
    compressed: bool = False,
    length: int | None = None,
    mask: bytes = b"\x11\x22\x33\x44",
) -> bytes:
    """Return a frame of a client.

    Args:
        payload: Data of the frame, before the mask.
        opcode: Kind of frame (RFC 6455 5.2).
        final: Whether the frame ends its message.
        masked: Whether the payload is masked, as RFC 6455 5.3 requires of clients.
        compressed: Whether the header declares a compressed payload (RSV1).
        length: Length in the header; None: the payload's.
        mask: Masking key, four bytes.
    """
    size = len(payload) if length is None else length
    bit = MASKED if masked else 0
    head = bytes([(FINAL if final else 0) | (COMPRESSED if compressed else 0) | opcode])
    if size <= SHORT:
        head += bytes([bit | size])
    elif size < 1 << 16:
        head += bytes([bit | MEDIUM]) + struct.pack(">H", size)
    else:
        head += bytes([bit | LONG]) + struct.pack(">Q", size)
    if not masked:
        return head + payload
    pad = (mask * (len(payload) // 4 + 1))[: len(payload)]
    both = int.from_bytes(payload, "big") ^ int.from_bytes(pad, "big")
    return head + mask + both.to_bytes(len(payload), "big")


def byte_fragments(payload: bytes, opcode: int = TEXT) -> bytes:
    """Return a message in frames of one byte each."""
    last = len(payload) - 1
    return b"".join(
        websocket_frame(payload[i : i + 1], opcode if i == 0 else CONTINUATION, final=i == last)
        for i in range(last + 1)
    )


def deflate_bomb(size: int) -> bytes:
    """Return a compressed payload that unpacks to `size` spaces."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    return (packer.compress(b" " * size) + packer.flush(zlib.Z_SYNC_FLUSH)).removesuffix(SYNC)


def http_request(path: str, port: int, *extra: str, version: str = "1.1") -> bytes:
    """Return a GET of a page of this machine, with further lines of its header."""
    lines = [f"GET {path} HTTP/{version}", f"Host: 127.0.0.1:{port}", *extra, "", ""]
    return "\r\n".join(lines).encode()


def upgrade_request(port: int) -> bytes:
    """Return the opening handshake of a websocket, which offers compression."""
    return http_request(
        "/",
        port,
        "Upgrade: websocket",
        "Connection: Upgrade",
        f"Sec-WebSocket-Key: {KEY}",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Extensions: permessage-deflate",
    )


def ros_message(op: str, **fields: object) -> bytes:
    """Return a frame with a message of rosbridge."""
    return websocket_frame(json.dumps({"op": op, **fields}).encode())


def deep_json(depth: int) -> bytes:
    """Return lists nested to a depth."""
    return b"[" * depth + b"]" * depth


def wide_json(count: int) -> bytes:
    """Return an object of `count` keys, each with a number that is slow to parse."""
    return json.dumps({f"k{i}": 0.1 + i for i in range(count)}).encode()


def init_line(name: str, number: int = 0) -> bytes:
    """Return INIT of a P2AT near the start of the yellow arena; each number has its own position."""
    x, y = 4.5 + 0.7 * (number % 4), 1.9 + 0.7 * (number // 4)
    return f"INIT {{ClassName USARBot.P2AT}} {{Name {name}}} {{Location {x:.2f},{y:.2f},1.8}}\r\n".encode()


def noise(size: int, seed: int) -> bytes:
    """Return random bytes, the same for a seed."""
    return random.Random(seed).randbytes(size)
