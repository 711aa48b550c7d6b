"""Icon of every FMU: a trembling line that runs into a steady one.

Drawn here and not shipped as a file, so that it can be read and changed. Importers scale it down to
some 48 pixels, hence thick lines and no text.
"""

import struct
import zlib
from functools import cache

import numpy as np

SIZE = 256
"""Width and height [pixels]."""
_PAPER, _TREMOR, _STEADY = (255, 255, 255), (200, 62, 44), (20, 92, 140)
_CORNER, _BORDER, _WIDTH = 36.0, 8.0, 15.0  # radius of the corners, frame, line [pixels]
_SETTLED = 0.56
"""Where the tremor has gone, as a share of the line."""


@cache
def png() -> bytes:
    """Draw the icon, a PNG of SIZE x SIZE pixels with transparent corners."""
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    inside = _rounded_square(x, y)
    canvas = np.empty((SIZE, SIZE, 3))
    canvas[:] = _STEADY
    canvas = _mix(canvas, _PAPER, _covered(inside + _BORDER))
    along = np.linspace(0.14, 0.86, 800)
    remaining = np.clip(1 - (along - 0.14) / (_SETTLED - 0.14), 0, 1)
    across = 0.5 - 0.26 * np.sqrt(remaining) * np.sin(2 * np.pi * (along - _SETTLED) / 0.13)
    for colour, part in ((_STEADY, along >= _SETTLED), (_TREMOR, along <= _SETTLED)):
        line = np.column_stack([along[part], across[part]]) * SIZE
        canvas = _mix(canvas, colour, _covered(_distance(x, y, line) - _WIDTH / 2))
    alpha = 255 * _covered(inside)
    return _encode(np.dstack([canvas, alpha]).round().astype(np.uint8))


def _rounded_square(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the signed distance from the icon's outline, negative inside [pixels]."""
    reach = SIZE / 2 - _CORNER
    beyond = [np.maximum(np.abs(v - SIZE / 2) - reach, 0) for v in (x, y)]
    return np.hypot(*beyond) - _CORNER


def _distance(x: np.ndarray, y: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return the distance of each pixel from a line of dense points [pixels]."""
    nearest = np.full(x.shape, np.inf)
    for px, py in line:
        np.minimum(nearest, np.hypot(x - px, y - py), out=nearest)
    return nearest


def _covered(distance: np.ndarray) -> np.ndarray:
    """Return the share of a pixel that a shape covers, by the distance of its edge."""
    share: np.ndarray = np.clip(0.5 - distance, 0, 1)
    return share


def _mix(canvas: np.ndarray, colour: tuple[int, ...], share: np.ndarray) -> np.ndarray:
    mixed: np.ndarray = canvas + share[..., None] * (np.array(colour) - canvas)
    return mixed


def _encode(pixels: np.ndarray) -> bytes:
    """Encode as PNG (ISO/IEC 15948): eight bits of red, green, blue, alpha; no filter."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        checksum = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", checksum)

    height, width, _ = pixels.shape
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    image = zlib.compress(rows, 9)
    end = chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", image) + end
