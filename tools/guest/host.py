"""The host's side: AF_CAN, the programs that make the guest, the cache folder."""

from __future__ import annotations

import errno
import os
import platform
import shutil
import socket
from pathlib import Path

PACKAGES = {
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "cpio": "cpio",
    "depmod": "kmod",
    "ip": "iproute2",
    "candump": "can-utils",
}
"""Program -> its Debian package. The last two are for the tests, in the guest and on the host."""

CACHE_VARIABLE = "FOURTANK_HIL_GUEST"
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


class GuestError(Exception):
    """There can be no guest here; the message is one line that says why and what to do."""


def has_can() -> bool:
    """Whether this kernel has AF_CAN."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except AttributeError:
        return False
    except OSError as error:
        return error.errno not in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT)
    return True


def obstacle() -> str:
    """Why the tests can't have CAN interfaces on this kernel; "" when they can."""
    if not has_can():
        return "this kernel has no AF_CAN"
    return "" if os.geteuid() == 0 else "only root may make CAN interfaces"


def cache_dir() -> Path:
    """Where the kernel is kept: $FOURTANK_HIL_GUEST, or fourtank-hil/guest in the user's cache."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return Path(named).absolute()
    caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(caches) / "fourtank-hil" / "guest"


def program(name: str) -> str:
    """Path of a program; always searches sbin too. Raises GuestError naming the packages that are missing."""
    found = _find(name)
    if found is None:
        raise GuestError(f"{name} is missing; as root: apt-get install --no-install-recommends {' '.join(missing())}")
    return found


def missing() -> list[str]:
    """The Debian packages whose programs are missing."""
    return [package for name, package in PACKAGES.items() if _find(name) is None]


def require_amd64_debian() -> None:
    """Raise GuestError where Debian's amd64 kernel is not available or can't run the host's programs."""
    if platform.machine() != "x86_64":
        raise GuestError(f"the guest runs this machine's programs on an amd64 kernel, and this is {platform.machine()}")
    if _find("apt-get") is None:
        raise GuestError("the guest's kernel comes from Debian's archive, and there is no apt-get here")


def _find(name: str) -> str | None:
    return shutil.which(name, path=f"{os.environ.get('PATH', '')}:{SYSTEM_PATH}")
