"""Settings of the C library's allocator."""

from __future__ import annotations

import ctypes
import platform


def keep_freed_ram() -> None:
    """Makes glibc keep freed RAM for this process; does nothing with another C library.

    By default glibc returns an update's activations to the kernel and gets them back, zeroed, at
    the next one, which costs a fifth to a third of the learning speed on CPUs.
    """
    if platform.libc_ver()[0] != "glibc":
        return
    trim_threshold, top_pad, mmap_max = -1, -2, -4
    libc = ctypes.CDLL(None)
    libc.mallopt(mmap_max, 0)
    libc.mallopt(trim_threshold, -1)  # never
    libc.mallopt(top_pad, 2**26)
