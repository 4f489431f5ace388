"""The backend that decodes: Dr.Jit on LLVM or CUDA, and how NumPy planes reach it.

Dr.Jit reads a NumPy array in place (LLVM) and its results are NumPy arrays without a copy. Three traps are handled
here. It loads whole packets, so a mapped array is read past its end when its size is no multiple of the packet. It
compiles one kernel for arrays that start at a packet and another for those that do not, so chance would decide what is
compiled. And it has no 16-bit integers: a uint16 plane is read as 32-bit words and split in the kernel (5 x faster than
converting).
"""

from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scenes.support import backend
from scenes.support.errors import BackendError, DecodeError

# One value per pixel inside a kernel: a Dr.Jit array of whichever backend decodes.
Lanes = Any

# No packet of any backend is wider than this many values.
PACKET = 64
# LLVM's packets have at most this many values (AVX-512), and an array is aligned where it starts at a multiple of them.
ALIGNED = 16


@lru_cache(maxsize=1)
def _best() -> str:
    """The machine's best backend, found once: where Dr.Jit is loaded, another LLVM comes too late."""
    return backend.select().name


@dataclass(frozen=True)
class Device:
    """A Dr.Jit backend: `dr` is the package, `types` its ``drjit.llvm`` or ``drjit.cuda``."""

    dr: Any
    types: Any

    @classmethod
    def open(cls, name: Literal["llvm", "cuda"] | None = None) -> "Device":
        """The named backend, else CUDA where there is a device, else LLVM. Raises `BackendError` if it is missing."""
        best = _best()
        chosen = name or best
        import drjit as dr  # After `select`, which sets where LLVM is.

        if not dr.has_backend(getattr(dr.JitBackend, chosen.upper())):
            raise BackendError(
                f"backend '{chosen}' is not usable on this machine: run `fringebench doctor`"
            )
        return cls(dr, import_module(f"drjit.{chosen}"))

    def root(self, x: Lanes) -> Lanes:
        """Square root of float32 lanes to 2 units in the last place: by multiplication, for the divider is the
        bottleneck.
        """
        return self.dr.select(x > 0.0, x * self.dr.rsqrt(x), x)

    def positive(self, x: Lanes) -> Lanes:
        """The greater of `x` and 0, NaN being 0: a quarter of the cost of `maximum`, which keeps NaN."""
        return self.dr.select(x > 0.0, x, 0.0)

    def plane(self, values: NDArray[Any], pixels: Lanes | None = None) -> Lanes:
        """An image (row, col) of uint8, uint16 or float32 as float32 lanes; `pixels` are the flat indices to read, by
        default all.
        """
        flat = np.ascontiguousarray(values).reshape(-1)
        types, dr = self.types, self.dr
        if flat.dtype == np.uint16:
            at = dr.arange(types.UInt32, flat.size) if pixels is None else pixels
            word = dr.gather(types.UInt32, types.UInt32(_words(flat)), at >> 1)
            return types.Float((word >> ((at & 1) << 4)) & 0xFFFF)
        kind = {np.dtype(np.uint8): types.UInt8, np.dtype(np.float32): types.Float}.get(flat.dtype)
        if kind is None:
            raise DecodeError(
                f"frames are {flat.dtype}: convert them to uint8, uint16 or float32 digital numbers"
            )
        lanes = kind(packets(flat))
        return types.Float(lanes if pixels is None else dr.gather(kind, lanes, pixels))

    def image(self, values: Lanes, shape: tuple[int, int]) -> NDArray[Any]:
        """Lanes as a host image of (rows, columns); a read-only view where all pixels have one value."""
        found = np.asarray(values.numpy())
        if found.size == 1:
            return np.broadcast_to(found, shape)
        return found.reshape(shape)


def packets(flat: NDArray[Any]) -> NDArray[Any]:
    """The same values (n,) at the start of a packet, in a buffer that reaches to the end of their last one: a copy where
    the array does not lie so (bytes always do where NumPy allocates them, at multiples of 16).
    """
    missing, alignment = -flat.size % PACKET, ALIGNED * flat.itemsize
    if flat.ctypes.data % alignment == 0 and _room_after(flat) >= missing * flat.itemsize:
        return flat
    buffer = np.zeros((flat.size + missing) * flat.itemsize + alignment, np.uint8)
    found = buffer[-buffer.ctypes.data % alignment :][: flat.nbytes].view(flat.dtype)
    found[:] = flat
    return found


def _room_after(flat: NDArray[Any]) -> int:
    """Bytes between the end of an array and the end of the array that owns its memory."""
    owner: NDArray[Any] = flat
    while isinstance(owner.base, np.ndarray):
        owner = owner.base
    if not owner.flags.c_contiguous:
        return 0
    return int(owner.ctypes.data + owner.nbytes - flat.ctypes.data - flat.nbytes)


def _words(flat: NDArray[np.uint16]) -> NDArray[np.uint32]:
    """Pairs of 16-bit values as 32-bit words (little endian), the first value in the low half."""
    if flat.size % 2 or flat.ctypes.data % 4:
        even = np.zeros(flat.size + flat.size % 2, np.uint16)
        even[: flat.size] = flat
        flat = even
    return flat.view(np.uint32)
