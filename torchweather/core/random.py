"""Keyed random streams: every variate of every stage of every sample has its own.

A draw belongs to (sample seed, stage, variate). Each triple owns a counter-based Philox stream, so that
inserting or removing a stage leaves all other draws unchanged, a batch equals its elements drawn with their
seeds, and the same numbers come out without torch (``export.draw_feed``).
"""

from __future__ import annotations

import hashlib
import math
import operator
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import lru_cache
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import uses_compiled
from torchweather.core.exceptions import InputTypeError, InputValueError
from torchweather.core.philox import NORMALS_A_BLOCK

# torch is imported where it is needed: the noise of an exported graph is drawn without it.
if TYPE_CHECKING:
    import torch
    from torch import Tensor

__all__ = [
    "ABSENT",
    "DRAWS",
    "Variate",
    "derived_seed",
    "draw_variates",
    "keyed_stream",
    "normal_table",
    "normals_of_key",
    "sample_seed",
    "sample_seeds",
    "sizes_of",
]

DRAWS = "torchweather-draws/2"
"""Name of the rule by which a seed becomes numbers.

Another rule is a breaking change: it gets a new number here, and a line in CHANGELOG.md.
"""

LAWS = ("uniform", "normal", "tabulated_normal", "exponential", "points")

# Value of a point's last column that marks an unused slot: no uniform reaches it.
ABSENT = 2.0

TABLE_SIZE = 1 << 16  # of the tabulated normal law
NORMALS_AT_ONCE = 1 << 16  # whose bits stay in the cache; a multiple of 4

# Below this many numbers a thread costs more than it saves.
THREADED_FROM = 1 << 19
COMPILED_FROM = 1 << 12  # likewise of a compiled loop
_MOST_SAMPLES = 1 << 31
_MOST_SEED = 1 << 63

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class Variate:
    """One named array of standard random numbers that a stage needs.

    Args:
        name: its name in the stage; the noise dictionary holds ``<stage>.<name>``.
        law: ``uniform`` [0, 1), ``normal``, ``exponential`` (mean 1), ``tabulated_normal`` (one of 65,536 values of
            equal probability, mean 0, variance 1, at most 4.4), or ``points``: a Poisson number of points with
            ``columns`` uniforms each, in slots. The last column is a point's level, in rising order; of an unused
            slot it is ``ABSENT``.
        shape: of one sample; integers or the names of sizes (``"C"``, ``"H"``, ``"W"``).
        per_px2: ``points`` only: expected points per pixel of the image enlarged by the margins.
        margin_x_px, margin_y_px: ``points`` only: margin on each side, pixels.
        columns: ``points`` only.
        level_limit: ``points`` only: slots for points of lower levels alone; they are the first ones of a whole draw.
    """

    name: str
    law: str
    shape: tuple[int | str, ...] = ()
    per_px2: float = 0.0
    margin_x_px: float = 0.0
    margin_y_px: float = 0.0
    columns: int = 0
    level_limit: float = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.law, str) or self.law not in LAWS:
            from torchweather.core.errors import check_one_of

            check_one_of("law", self.law, LAWS, owner=self)
        if not isinstance(self.shape, (list, tuple)) or not all(
            isinstance(one, str) or (isinstance(one, int) and one >= 0) for one in self.shape
        ):
            raise InputTypeError(f"Variate: shape must hold whole numbers and names of sizes; got {self.shape!r}.")
        object.__setattr__(self, "shape", tuple(self.shape))

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as an exported graph carries them in its metadata."""
        values = {**asdict(self), "shape": list(self.shape)}
        del values["level_limit"]  # of a call, not of a graph
        return values

    def mean_points(self, sizes: Mapping[str, int]) -> float:
        """Expected number of points on an image of these sizes."""
        return self.per_px2 * (sizes["W"] + 2 * self.margin_x_px) * (sizes["H"] + 2 * self.margin_y_px)

    def sample_shape(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """Shape of one sample's array; it depends on sizes only, never on what was drawn."""
        if self.law == "points":
            mean = self.mean_points(sizes)
            # 6 standard deviations above the mean: exceeded once in 1e9 draws (then the surplus is cut off).
            whole = math.ceil(mean + 6 * math.sqrt(mean)) + 4
            below = mean * self.level_limit
            # 9 of them below a limit: no surplus there, so that a point is lost by the whole draw's rule alone.
            return (min(whole, math.ceil(below + 9 * math.sqrt(below)) + 40), self.columns)
        return tuple(sizes[size] if isinstance(size, str) else size for size in self.shape)


def keyed_stream(seed: int, stream: str) -> np.random.Generator:
    """The Philox stream that belongs to a sample's ``seed`` and a name ``<stage>.<variate>``.

    Example:
        >>> float(keyed_stream(7, "jitter.normal").random()) == float(keyed_stream(7, "jitter.normal").random())
        True
    """
    return np.random.Generator(np.random.Philox(key=_key(seed, stream)))


def _key(seed: int, stream: str) -> NDArray[np.uint64]:
    """Key of the Philox stream, two words."""
    if not isinstance(stream, str):
        raise InputTypeError(f"keyed_stream: stream must be text, such as rain.uniform; got {stream!r}.")
    digest = hashlib.blake2b(stream.encode("utf-8", "surrogatepass"), digest_size=8).digest()
    return np.array([_whole(seed, "seed") & (2**64 - 1), int.from_bytes(digest, "little")], dtype=np.uint64)


def normals_of_key(key: NDArray[np.uint64], shape: Sequence[int], first: int = 0) -> NDArray[np.float32]:
    """Tabulated normals of a key that ``draw_variates(keyed=True)`` gave in their place, from number ``first`` on."""
    out = np.empty(tuple(shape), dtype=np.float32)
    blocks, within = divmod(first, NORMALS_A_BLOCK)
    _fill_normals(np.random.Generator(np.random.Philox(key=key).advance(blocks)), out, within)
    return out


def _fill_normals(generator: np.random.Generator, out: NDArray[np.float32], within: int = 0) -> None:
    """Fill an array with tabulated normals, less than a block of which are passed over."""
    flat, table = out.reshape(-1), normal_table()
    for begin in range(0, within + flat.size, NORMALS_AT_ONCE):
        some = flat[max(begin - within, 0) : begin - within + NORMALS_AT_ONCE]
        over = 0 if begin else within
        raw: NDArray[np.uint64] = generator.bit_generator.random_raw(-(-(over + some.size) // 4))
        # 16 bits each, the lowest first
        np.take(table, raw.astype("<u8", copy=False).view("<u2")[over : over + some.size], out=some, mode="clip")


def sample_seed(seed: int, key: int | str, epoch: int = 0) -> int:
    """The integer of a sample: the same on every machine, in every process and in any order.

    Args:
        seed: of the whole run.
        key: the sample's own: its number, file name or token.
        epoch: how often the data were gone through before.

    Returns:
        63 bits.

    Example:
        >>> sample_seed(7, "000042") == sample_seed(7, "000042"), sample_seed(7, "000042") == sample_seed(7, "000043")
        (True, False)
    """
    if not isinstance(key, (int, str, np.integer)):
        raise InputTypeError(f"sample_seed: key must be a whole number or text; got {key!r}.")
    return _hashed(f"{_whole(seed, 'seed')}/{_whole(epoch, 'epoch')}/{type(key).__name__}/{key}")


def derived_seed(seed: int, name: str) -> int:
    """The integer of a part of a sample, such as one of its sensors; 63 bits."""
    if not isinstance(name, str):
        raise InputTypeError(f"derived_seed: name must be text; got {name!r}.")
    return _hashed(f"{_whole(seed, 'seed')}.{name}")


def _whole(value: Any, name: str) -> int:
    """A whole number, also one of numpy or in a tensor."""
    try:
        if not isinstance(value, (bool, np.bool_)):
            return operator.index(value)
    except TypeError:
        pass
    raise InputTypeError(f"draw: {name} must be a whole number; got {value!r}.")


def _hashed(text: str) -> int:
    # Names of files need not be Unicode: what is none comes as lone surrogates.
    content = text.encode("utf-8", "surrogatepass")
    return int.from_bytes(hashlib.blake2b(content, digest_size=8).digest(), "little") >> 1


def _fill(seed: int, stream: str, variate: Variate, sizes: Mapping[str, int], out: NDArray[np.float32]) -> None:
    if variate.law == "uniform":
        _fill_uniforms(seed, stream, out)
    elif variate.law == "normal":
        _fill_standard_normals(seed, stream, out)
    elif variate.law == "tabulated_normal":
        _fill_normals(keyed_stream(seed, stream), out)
    elif variate.law == "exponential":
        keyed_stream(seed, stream).standard_exponential(out=out, dtype=np.float32)
    else:
        _fill_uniforms(seed, stream, out)
        # Levels of a Poisson process in rising order: the gaps are exponential. A shorter draw has the same ones first.
        gaps = keyed_stream(seed, f"{stream}.level").standard_exponential(len(out))
        mean = variate.mean_points(sizes)
        if len(out) >= COMPILED_FROM and mean > 0 and _has_loops():
            from torchweather.core.compiled_philox import write_levels

            write_levels(out[:, -1], gaps, mean, ABSENT)
            return
        level = (np.cumsum(gaps) / mean if mean > 0 else np.full(len(out), ABSENT)).astype(np.float32)
        out[:, -1] = np.where(level < 1.0, level, np.float32(ABSENT))


def _fill_uniforms(seed: int, stream: str, out: NDArray[np.float32]) -> None:
    if _pays_loops(out):
        from torchweather.core.compiled_philox import draw_uniforms

        draw_uniforms(out.reshape(-1), *_key(seed, stream))
    else:
        keyed_stream(seed, stream).random(out=out, dtype=np.float32)


def _fill_standard_normals(seed: int, stream: str, out: NDArray[np.float32]) -> None:
    if _pays_loops(out):
        from torchweather.core.compiled_philox import draw_standard_normals, ziggurat

        key, tables = _key(seed, stream), ziggurat()
        if tables is not None:
            draw_standard_normals(out.reshape(-1), key[0], key[1], tables)
            return
    keyed_stream(seed, stream).standard_normal(out=out, dtype=np.float32)


def _pays_loops(out: NDArray[np.float32]) -> bool:
    """True where compiled loops draw such an array, and in less time than numpy."""
    return out.size >= COMPILED_FROM and sys.byteorder == "little" and _has_loops()


def _has_loops() -> bool:
    """True where numba is there and loaded: its numbers are the same bits, and to load it takes half a second."""
    return "numba" in sys.modules and uses_compiled()


@lru_cache(maxsize=1)
def normal_table() -> NDArray[np.float32]:
    """Means of the standard normal law over 65,536 ranges of equal probability, scaled to variance 1."""
    inner = NormalDist()
    edges = np.array([inner.inv_cdf(k / TABLE_SIZE) for k in range(1, TABLE_SIZE // 2 + 1)])
    density = np.concatenate([[0.0], np.exp(-0.5 * edges**2) / math.sqrt(2.0 * math.pi)])
    below = -np.diff(density) * TABLE_SIZE  # mean over a range: the densities at its ends, over its probability
    table = np.concatenate([below, -below[::-1]])
    scaled: NDArray[np.float32] = (table / np.sqrt((table**2).mean())).astype(np.float32)
    return scaled


def draw_variates(
    seeds: Sequence[int],
    stage: str,
    variates: Sequence[Variate],
    sizes: Mapping[str, int],
    *,
    only: Sequence[bool] | None = None,
    keyed: bool = False,
) -> dict[str, NDArray[Any]]:
    """Draw a stage's variates for every sample, each from its own stream.

    Args:
        seeds: one integer a sample.
        stage: the stage's name in its chain.
        variates: what the stage needs.
        sizes: values of the named sizes, for example ``{"H": 1464, "W": 1936}``.
        only: which samples are drawn; the numbers of the others are 0. ``None`` draws all.
        keyed: give the keys of tabulated normals in their place, int64 ``(len(seeds), 2)``, for a stage that takes
            numbers from their streams when it needs them (``normals_of_key``).

    Returns:
        ``<stage>.<variate>`` to float32 array ``(len(seeds), *sample shape)``.
    """
    _check_sizes(sizes)
    if not isinstance(seeds, Sequence) or isinstance(seeds, str):
        raise InputTypeError(f"draw_variates: seeds must be a sequence of whole numbers; got {seeds!r:.200}.")
    if not isinstance(variates, (list, tuple)) or not all(isinstance(one, Variate) for one in variates):
        raise InputTypeError(f"draw_variates: variates must be a sequence of Variate; got {variates!r:.200}.")
    drawn: dict[str, NDArray[Any]] = {}
    tasks = []
    for variate in variates:
        stream = f"{stage}.{variate.name}"
        if keyed and variate.law == "tabulated_normal":
            drawn[stream] = np.array([_key(seed, stream) for seed in seeds], np.uint64).reshape(-1, 2).view(np.int64)
            continue
        every = only is None or all(only)
        # Zeros that nobody reads take no memory.
        array = (np.empty if every else np.zeros)((len(seeds), *variate.sample_shape(sizes)), dtype=np.float32)
        drawn[stream] = array
        tasks += [
            (seed, stream, variate, sizes, array[row]) for row, seed in enumerate(seeds) if only is None or only[row]
        ]
    in_parallel(lambda task: _fill(*task), tasks, sum(array.size for array in drawn.values()))
    return drawn


def _check_sizes(sizes: Mapping[str, int]) -> None:
    whole = isinstance(sizes, Mapping) and all(isinstance(size, (int, np.integer)) for size in sizes.values())
    if not whole or any(size < 0 for size in sizes.values()):
        raise InputTypeError(f"draw_variates: sizes must be names with whole numbers, 0 or more; got {sizes!r}.")


def in_parallel(function: Callable[[T], R], items: Sequence[T], numbers: int) -> list[R]:
    """The function of each item; on threads where there are many random ``numbers`` to draw in all."""
    workers = min(len(items), _threads())
    if workers <= 1 or numbers < THREADED_FROM:
        return [function(item) for item in items]
    with ThreadPoolExecutor(max_workers=workers) as pool:
        return list(pool.map(function, items))


def _threads() -> int:
    """As many threads as torch uses (one in a ``DataLoader``'s worker), or the machine's cores without torch."""
    torch = sys.modules.get("torch")
    return os.cpu_count() or 1 if torch is None else int(torch.get_num_threads())


def sample_seeds(
    batch_shape: Sequence[int], generator: torch.Generator | None = None, seed: int | Tensor | None = None
) -> list[int]:
    """One 63-bit integer per sample.

    Args:
        batch_shape: leading dimensions of the data; ``()`` is one sample.
        generator: torch generator to take them from; ``None`` is torch's global one, which a ``DataLoader``
            seeds per worker.
        seed: the integers themselves: a tensor of the batch shape, or one integer s, by which the samples get
            s, s + 1, s + 2, ... in order.

    Returns:
        The integers, in the batch's row-major order.

    Example:
        >>> sample_seeds((3,), seed=7)
        [7, 8, 9]
    """
    import torch

    if not isinstance(batch_shape, Sequence) or not all(isinstance(one, int) and one >= 0 for one in batch_shape):
        raise InputTypeError(f"draw: batch_shape must be whole numbers, 0 or more; got {batch_shape!r}.")
    if generator is not None and not isinstance(generator, torch.Generator):
        raise InputTypeError(f"draw: generator must be a torch.Generator; got {generator!r}.")
    number = math.prod(batch_shape)
    if number > _MOST_SAMPLES:
        raise InputValueError(f"draw: batch_shape must be of {_MOST_SAMPLES} samples at most; got {number:.3g}.")
    if seed is not None and generator is not None:
        raise InputValueError("draw: give either seed or generator, not both.")
    if isinstance(seed, torch.Tensor):
        if tuple(seed.shape) != tuple(batch_shape) and seed.numel() != 1:
            raise InputValueError(
                f"draw: seed must be one integer or a tensor of the batch shape {tuple(batch_shape)}; "
                f"got shape {tuple(seed.shape)}."
            )
        if seed.is_floating_point() or seed.is_complex():
            raise InputTypeError(f"draw: seed must hold integers; got dtype {seed.dtype}.")
        if tuple(seed.shape) == tuple(batch_shape):
            return [int(value) for value in seed.reshape(-1).tolist()]
        seed = int(seed)
    if seed is not None:
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)):
            raise InputTypeError(f"draw: seed must be an integer or an integer tensor; got {seed!r}.")
        if not -_MOST_SEED <= seed <= _MOST_SEED - number:
            raise InputValueError(f"draw: seed must fit 64 bits with its sign, -2^63 to 2^63; got {seed}.")
        return [int(seed) + row for row in range(number)]
    device = generator.device if generator is not None else "cpu"
    return [int(v) for v in torch.randint(0, 2**63 - 1, (number,), generator=generator, device=device).tolist()]


def sizes_of(height: int, width: int, planes: int = 1) -> dict[str, int]:
    """The named sizes of an image: ``C`` is 1 for a mosaic and 3 for colour planes."""
    return {"C": planes, "H": height, "W": width}
