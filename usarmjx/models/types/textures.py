"""Names and codes of textures, for pictures alone; `cameras.textures` draws them."""

from typing import Any

TEXTURES = ("brick", "tiles", "wood", "concrete", "chart", "hazmat", "tag", "qr")
"""All textures: patterns of walls and floors, and signs."""
SIGNS = {"chart": 999, "hazmat": 5, "tag": 9, "qr": 9}
"""Textures that are signs in the middle of each face of a box, with their largest numbers (`tag:7`)."""
CODE_STRIDE = 16
"""Number of texture codes per sign number: a code is one plus the index of the texture, plus this times its
number."""


def texture_problem(texture: str) -> str:
    """Return the error of a texture's name, "" if it is valid; "" itself is no texture."""
    name, colon, number = texture.partition(":")
    if not texture or (name in TEXTURES and not colon):
        return ""
    if name in SIGNS and number.isdecimal() and int(number) <= SIGNS[name]:
        return ""
    signs = ", ".join(f"{name}:0 to {name}:{last}" for name, last in SIGNS.items())
    plain = ", ".join(name for name in TEXTURES if name not in SIGNS)
    return f"no texture {texture!r}; known: {plain}, {signs}"


def texture_code(texture: str) -> int:
    """Return the code of a texture; 0 is no texture."""
    name, _, number = texture.partition(":")
    return TEXTURES.index(name) + 1 + CODE_STRIDE * int(number or 0) if name else 0


def decode_texture(code: Any) -> tuple[Any, Any]:  # noqa: ANN401 - a whole number, or an array of them
    """Return the texture, counted from 1, and the sign number of codes."""
    return code % CODE_STRIDE, code // CODE_STRIDE


def texture_names(codes: Any) -> frozenset[str]:  # noqa: ANN401 - whole numbers
    """Return the names of the textures of some codes."""
    return frozenset(TEXTURES[int(code) % CODE_STRIDE - 1] for code in codes if code)
