"""How planes reach the kernel: every type and layout, and no read past the end."""

import itertools
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import decode
from decode.device import Device, packets
from scenes.acquisition.patterns import PhaseShift
from scenes.rig.devices import LookAt
from scenes.support.errors import DecodeError
from tests.commands import program
from tests.decode.synthetic import calibrated_stack, hills, rig


@pytest.fixture(scope="module")
def device() -> Device:
    return Device.open()


@pytest.mark.parametrize("size", [1, 2, 15, 64, 67, 1001])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_planes_arrive_exactly_at_any_size_and_alignment(
    device: Device, dtype: type, size: int
) -> None:
    rng = np.random.default_rng(size)
    top = 1 if dtype is np.float32 else np.iinfo(dtype).max
    whole: NDArray[Any] = (rng.random((3, size)) * top).astype(dtype)
    whole[1, 0] = top
    for plane in (*whole, whole[:, ::2][0], whole.T[:, 1]):
        assert np.array_equal(device.plane(plane).numpy(), plane.astype(np.float32))
    picked = device.types.UInt32(np.arange(size, dtype=np.uint32)[::-1].copy())
    assert np.array_equal(device.plane(whole[1], picked).numpy(), whole[1, ::-1].astype(np.float32))


def test_read_only_frames_are_decoded_without_a_copy(device: Device) -> None:
    plane = np.arange(128, dtype=np.uint8)
    plane.flags.writeable = False
    assert np.array_equal(device.plane(plane).numpy(), np.arange(128))


def test_other_types_are_refused(device: Device) -> None:
    with pytest.raises(DecodeError, match="frames are int32"):
        device.plane(np.zeros((2, 2), np.int32))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs mprotect")
def test_no_kernel_reads_past_the_end_of_a_stack() -> None:
    """Dr.Jit loads whole packets: a mapped array that ends at an unreadable page would kill the process."""
    code = """
import ctypes, itertools, mmap
import numpy as np
from decode.device import Device, packets
pages = mmap.mmap(-1, 3 * mmap.PAGESIZE)
at = ctypes.addressof(ctypes.c_char.from_buffer(pages))
libc = ctypes.CDLL(None)
assert libc.mprotect(ctypes.c_void_p(at + 2 * mmap.PAGESIZE), ctypes.c_size_t(mmap.PAGESIZE), 0) == 0
device = Device.open("llvm")
for name, size in itertools.product(("uint8", "uint16", "float32"), (67, 1000, 1001)):
    print(name, size, flush=True)
    dtype = np.dtype(name)
    start = 2 * mmap.PAGESIZE - size * dtype.itemsize
    pages[start : 2 * mmap.PAGESIZE] = np.ones(size, dtype).tobytes()
    plane = np.frombuffer(pages, dtype, size, start)
    for lanes in (device.plane(plane), device.plane(plane, device.dr.arange(device.types.UInt32, size))):
        assert (lanes + 1.0).numpy().sum() == 2 * size
"""
    done = program(code)
    assert done.returncode == 0, f"{done.stdout}status {done.returncode}: {done.stderr}"


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
def test_arrays_start_where_a_packet_does_and_reach_its_end(dtype: type) -> None:
    memory: NDArray[Any] = np.arange(4096, dtype=dtype)
    for size, start in itertools.product((1, 15, 64, 67, 200, 1001), range(24)):
        flat = memory[start : start + size]
        found = packets(flat)
        assert np.array_equal(found, flat)
        assert found.ctypes.data % (16 * flat.itemsize) == 0
        owner = found.base
        assert owner is not None
        end = owner.ctypes.data + owner.nbytes
        assert found.ctypes.data + -(-size // 64) * 64 * flat.itemsize <= end


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_where_an_array_lies_compiles_no_new_kernel(device: Device, dtype: type) -> None:
    """NumPy allocates at any multiple of 16 bytes, and a view starts at any element."""
    dr = device.dr

    def compiled(start: int) -> int:
        plane: NDArray[Any] = memory[start : start + 256 * np.dtype(dtype).itemsize].view(dtype)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            assert (device.plane(plane) + 3.0).numpy().sum() == 256 * 3
            kernels = dr.kernel_history([dr.KernelType.JIT])
        assert kernels
        return sum(not kernel["cache_hit"] for kernel in kernels)

    memory = np.zeros(2048, np.uint8)
    packet = -memory.ctypes.data % 64
    compiled(packet)
    assert [compiled(packet + offset) for offset in (2, 4, 16, 32, 64)] == [0] * 5


def test_another_rig_or_exposure_time_compiles_no_new_kernel(device: Device) -> None:
    """A data set of random rigs would else spend its time in the compiler."""
    patterns = PhaseShift(periods_px=(16.0, 80.0))
    dr = device.dr

    def compiled(camera_mm: float, times: tuple[float, ...]) -> int:
        calibration = rig("pinhole", "telecentric")
        pose = LookAt(origin_mm=(0, 0, camera_mm))
        moved = calibration.camera.model_copy(update={"pose": pose})
        calibration = calibration.model_copy(update={"camera": moved})
        one = calibrated_stack(calibration, hills(), patterns, dtype=np.uint8)
        frames = np.repeat(one.frames, len(times), axis=0)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            decode.reconstruct(replace(one, frames=frames, exposure_ms=times))
            kernels = dr.kernel_history([dr.KernelType.JIT])
        assert kernels
        return sum(not kernel["cache_hit"] for kernel in kernels)

    compiled(60.0, (1.0, 2.0))
    assert compiled(61.0, (1.59, 2.53)) == 0
