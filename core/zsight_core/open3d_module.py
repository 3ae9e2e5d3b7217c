"""Late import of open3d, which is slow and big, and fails on a bare machine without libusb."""

from __future__ import annotations

import ctypes
from typing import Any

__all__ = ["load"]


def load() -> Any:
    """The open3d module.

    open3d's library links libusb-1.0, which a bare machine lacks; the copy in ``libusb_package`` is loaded first with
    its symbols global, so that the dynamic linker finds it.

    Raises:
        ImportError: the perception extra is not installed, or a system library is missing; says which.
    """
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        pass  # a system-wide libusb may still be there: let open3d decide
    try:
        import open3d
    except ModuleNotFoundError as error:
        raise ImportError(f"{error.name} is not installed; it comes with: pip install 'zsight[perception]'") from error
    except (ImportError, OSError) as error:
        libraries = "libegl1 libgl1 libgomp1 libx11-6"
        raise ImportError(f"open3d does not load ({error}); on Debian it needs: apt-get install {libraries}") from error
    return open3d
