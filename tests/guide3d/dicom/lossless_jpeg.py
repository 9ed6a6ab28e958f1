"""A JPEG lossless encoder (process 14, selection value 1) for test files: one Huffman table, every category 5 bits."""

import struct

import numpy as np

_CATEGORIES = 17
_BITS = 5  # of each code: 17 codes of one length; the code of ones only is not used


def encode_lossless(image: np.ndarray, bits: int) -> bytes:
    """Encodes a grey image (h, w) of 2 to 16 bits a pixel.

    Source:
        ITU-T T.81, annex H: difference to the left pixel, in the first column to the one above, at the start to half
        the range; Huffman code of its category, then its low bits.
    """
    height, width = image.shape
    values = image.astype(np.int64)
    predicted = np.empty_like(values)
    predicted[:, 1:] = values[:, :-1]
    predicted[1:, 0] = values[:-1, 0]
    predicted[0, 0] = 1 << (bits - 1)
    stream = []
    for difference in (values - predicted).ravel().tolist():
        category = abs(difference).bit_length()
        stream.append(f"{category:0{_BITS}b}")
        if 0 < category < 16:
            low = difference if difference > 0 else difference + (1 << category) - 1
            stream.append(f"{low:0{category}b}")
    text = "".join(stream)
    text += "1" * (-len(text) % 8)
    data = int(text, 2).to_bytes(len(text) // 8, "big").replace(b"\xff", b"\xff\x00")
    counts = bytes(_CATEGORIES if length == _BITS else 0 for length in range(1, 17))
    return b"".join(
        [
            b"\xff\xd8",
            _segment(0xC3, struct.pack(">BHHB", bits, height, width, 1) + bytes([1, 0x11, 0])),
            _segment(0xC4, b"\x00" + counts + bytes(range(_CATEGORIES))),
            _segment(0xDA, bytes([1, 1, 0x00, 1, 0, 0])),
            data,
            b"\xff\xd9",
        ]
    )


def _segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body
