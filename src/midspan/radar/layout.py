"""How a chirp radar's samples lie in a file: 16-bit words to a cube (frames, chirps, receivers, samples) and back.

Two lanes (xWR16xx, 18xx, 68xx): the samples of receiver 0, then of receiver 1 …, in groups of four words whose order
has a name. Four lanes (xWR12xx, 14xx): each sample of all four receivers together, I of each and then Q of each.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.checks import option, refuse
from midspan.radar.chirp import ChirpProfile

Words = NDArray[np.int16]
Cube = NDArray[np.complex64]

ORDERS = ("IIQQ", "QQII", "IQIQ", "QIQI")
WORD_BYTES = 2
# Payload of one packet of the DCA1000.
PACKET_BYTES = 1456
LANE_RECEIVERS = 4  # a capture over four lanes always stores four receivers, unused ones too
# Places of I[0], I[1], Q[0], Q[1] in a group of four words.
_PLACES = {"IIQQ": (0, 1, 2, 3), "QQII": (2, 3, 0, 1), "IQIQ": (0, 2, 1, 3), "QIQI": (1, 3, 0, 2)}


@dataclass(frozen=True, slots=True)
class Layout:
    """The cube's axes and the order of its words: `lanes` 2 or 4, `order` one of `ORDERS` (first letter on 4)."""

    profile: ChirpProfile
    order: str = "IIQQ"
    lanes: int = 2

    def __post_init__(self) -> None:
        option("iq_order", self.order, ORDERS)
        if self.lanes not in (2, 4):
            raise refuse("lanes", "2 or 4", self.lanes)
        if self.lanes == 2 and self.profile.complex_samples and self.profile.samples % 2:
            raise refuse("samples", "an even number on two lanes", self.profile.samples)

    @property
    def stored(self) -> int:
        """Receivers that are stored, unused ones of a capture over four lanes too."""
        return LANE_RECEIVERS if self.lanes == 4 else self.profile.receivers

    @property
    def parts(self) -> int:
        """Words a sample: 2 for I and Q, 1 for real samples."""
        return 2 if self.profile.complex_samples else 1

    @property
    def frame_words(self) -> int:
        """16-bit words of one frame."""
        return self.profile.chirps * self.stored * self.profile.samples * self.parts

    @property
    def frame_bytes(self) -> int:
        """Bytes of one frame."""
        return self.frame_words * WORD_BYTES

    def arithmetic(self) -> str:
        """How the bytes of a frame come about, for messages."""
        kind = "2 (I and Q)" if self.parts == 2 else "1 (real)"
        return (
            f"{self.profile.chirps} chirps × {self.stored} receivers × {self.profile.samples} samples × {kind} × 2 "
            f"bytes = {self.frame_bytes} bytes a frame"
        )


def sign_extended(words: Words, bits: int) -> Words:
    """Words (…) of a 12 or 14 bit ADC with their sign carried up to 16 bits; 16 bit words as they are."""
    if bits == 16:
        return words
    shift = np.int16(16 - bits)
    return np.right_shift(np.left_shift(words, shift), shift)


def unpack(words: Words, layout: Layout) -> Cube:
    """The cube (frames, chirps, receivers, samples), complex64, of whole frames of words (frames · words a frame,)."""
    profile = layout.profile
    values = sign_extended(np.ascontiguousarray(words), profile.bits).astype(np.float32)
    parts = values.reshape(-1, block_words(layout))[:, word_places(layout)]
    out = np.zeros(
        (len(values) // layout.frame_words, profile.chirps, profile.receivers, profile.samples), np.complex64
    )
    out.real = parts[:, 0].reshape(out.shape)
    if layout.parts == 2:
        out.imag = parts[:, 1].reshape(out.shape)
    return out


def pack(cube: NDArray[np.complexfloating], layout: Layout) -> Words:
    """Words (frames · words a frame,) of a cube (frames, chirps, receivers, samples), rounded, within the ADC."""
    highest = 2 ** (layout.profile.bits - 1) - 1
    places = word_places(layout)
    words = np.zeros((len(cube) * layout.frame_words // block_words(layout), block_words(layout)), dtype=np.int16)
    for part, at in zip((cube.real, cube.imag), places, strict=False):
        words[:, at] = np.clip(np.rint(part), -highest - 1, highest).reshape(len(words), *at.shape)
    return words.ravel()


def word_places(layout: Layout) -> NDArray[np.int64]:
    """Where the words of one block lie: (parts, receivers of the block, samples); see `block_words`."""
    n = np.arange(layout.profile.samples)
    if layout.lanes == 4:
        receivers = np.arange(layout.profile.receivers)[:, None]
        step = LANE_RECEIVERS * layout.parts
        first = LANE_RECEIVERS if layout.parts == 2 and layout.order[0] == "Q" else 0
        both = [n * step + first + receivers, n * step + (LANE_RECEIVERS - first) + receivers]
        return np.stack(both[: layout.parts])
    if layout.parts == 1:
        return n[None, None]
    places = np.array(_PLACES[layout.order])
    return np.stack([4 * (n // 2) + places[n % 2], 4 * (n // 2) + places[2 + n % 2]])[:, None]


def block_words(layout: Layout) -> int:
    """Words that lie together: one receiver's chirp on two lanes, one chirp of all receivers on four."""
    return layout.frame_words // (layout.profile.chirps * (1 if layout.lanes == 4 else layout.stored))


def word_weights(kernel: NDArray[np.complexfloating], layout: Layout) -> NDArray[np.float32]:
    """Weights (words of a block, columns) by which raw words are multiplied to give Σ kernel · sample.

    kernel (k, samples): one complex weight a sample for each of k products. Columns: (receivers of the block, k, real
    and imaginary part), flattened.
    """
    places = word_places(layout)
    receivers = places.shape[1]
    out = np.zeros((block_words(layout), receivers, len(kernel), 2), dtype=np.float32)
    for receiver in range(receivers):
        out[places[0, receiver], receiver, :, 0] = kernel.real.T
        out[places[0, receiver], receiver, :, 1] = kernel.imag.T
        if layout.parts == 2:
            out[places[1, receiver], receiver, :, 0] = -kernel.imag.T
            out[places[1, receiver], receiver, :, 1] = kernel.real.T
    return out.reshape(len(out), -1)
