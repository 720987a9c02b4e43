"""Pictures compressed as first differences in Huffman's code, as the volumes of Voyager hold them.

Each line begins with its first sample; every further one is the sample before it minus a difference, modulo 256. The code
of the differences follows from their histogram, which the file holds: the two rarest are joined until one is left, a joined
pair going before others that are as rare; of a pair the rarer is bit 0.

All lines are decoded together, a bit of each at a time, so that a line costs what its longest neighbor does.

Source: the PDS' description of the Voyager volumes (VGISS), and the histograms in their files.
"""

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import IntArray
from opnav_workbench.image.file_bytes import check_size, image_error

__all__ = ["ENCODING", "read_first_differences"]

ENCODING = "HUFFMAN_FIRST_DIFFERENCE"
DIFFERENCES = 511  # -255 to 255
Bytes = NDArray[np.uint8]


def read_first_differences(
    name: str, histogram: Sequence[bytes], lines: Sequence[bytes], samples: int
) -> Bytes:
    """Return the samples (n_line, samples) of compressed lines.

    Parameters
    ----------
    name
        The file, for messages.
    histogram
        Records that begin with the differences' histogram: 511 whole numbers of four bytes, the lowest first.
    lines
        A record each.
    samples
        Of a line.

    Raises
    ------
    ImageError
        There is no histogram, or a line ends too early or belongs to another code.
    """
    stored = b"".join(histogram)[: 4 * DIFFERENCES]
    counts = np.frombuffer(stored.ljust(4 * DIFFERENCES, b"\0"), "<u4")
    if len(stored) < 4 * DIFFERENCES or np.count_nonzero(counts) < 2:
        raise image_error(name, "its encoding histogram is not there; copy or download the file again.")
    check_size(name, len(lines) * samples)
    if not lines or min(len(line) for line in lines) < 1:
        raise image_error(name, "truncated: no line of the image is there; copy or download the file again.")
    pixels, known = _decoded(lines, samples, *_tree(counts))
    if known.min() < samples:
        short = int(np.argmin(known))
        raise image_error(
            name,
            f"damaged: line {short} of the compressed image gives {known[short]} of {samples} samples; copy or download "
            "the file again.",
        )
    return pixels


def _tree(counts: NDArray[np.uint32]) -> tuple[IntArray, int]:
    """Return the code as a tree: for each node and bit the next node, or -1 - the difference's place; and its root."""
    order = np.argsort(counts, kind="stable")
    used = [int(i) for i in order if counts[i] > 0]
    weights, nodes = [int(counts[i]) for i in used], [-1 - i for i in used]
    children: list[tuple[int, int]] = []
    while len(nodes) > 1:
        children.append((nodes[0], nodes[1]))
        weight = weights[0] + weights[1]
        del weights[:2], nodes[:2]
        place = bisect_left(weights, weight)
        weights.insert(place, weight)
        nodes.insert(place, len(children) - 1)
    return np.array(children, dtype=np.int64), len(children) - 1


def _decoded(lines: Sequence[bytes], samples: int, tree: IntArray, root: int) -> tuple[Bytes, IntArray]:
    """Return samples (n_line, samples), and how many of each line are known."""
    width = max(len(line) for line in lines)
    packed = np.zeros((len(lines), width), np.uint8)
    for row, line in enumerate(lines):
        packed[row, : len(line)] = np.frombuffer(line, np.uint8)
    bits_there = 8 * (np.array([len(line) for line in lines]) - 1)
    pixels = np.zeros((len(lines), samples), np.uint8)
    pixels[:, 0] = packed[:, 0]
    known, node = np.ones(len(lines), np.int64), np.full(len(lines), root)
    for bit in range(8 * (width - 1)):
        going = np.flatnonzero((known < samples) & (bit < bits_there))
        if len(going) == 0:
            break
        column = packed[going, 1 + bit // 8] >> np.uint8(7 - bit % 8)
        after = tree[node[going], column & np.uint8(1)]
        done = after < 0
        node[going] = np.where(done, root, after)
        ended, at = going[done], known[going[done]]
        # The difference at place i is i - 255, taken from what is before; its name is counted from 1, modulo 256.
        pixels[ended, at] = pixels[ended, at - 1] - (-after[done]).astype(np.uint8)
        known[ended] += 1
    return pixels, known
