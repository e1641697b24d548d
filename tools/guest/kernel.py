"""The guest's kernel: Debian's package, unpacked into the cache only, and the files that it boots with.

Nothing is installed: no /boot, no /lib/modules, no hooks.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from tools.guest.host import GuestError, program, require_amd64_debian

METAPACKAGE = "linux-image-amd64"
WANTED = (
    "net/can", "drivers/net/can", "net/sched", "net/9p", "fs/9p", "fs/netfs", "fs/fscache", "fs/overlayfs",
    "drivers/virtio", "drivers/char/virtio_console*", "drivers/char/hw_random", "lib", "crypto",
)  # fmt: skip
"""Folders of the package's modules with all that the guest or a test loads."""

AT_BOOT = (
    "virtio_pci", "virtio_console", "virtio_rng", "9pnet_virtio", "9p", "overlay", "can_raw", "vcan", "kvaser_pci",
)  # fmt: skip
INIT = Path(__file__).with_name("init.sh")


@dataclass(frozen=True)
class Kernel:
    """An unpacked kernel. folder : holds boot/ and lib/modules/. release : as `uname -r` prints it."""

    folder: Path
    release: str

    @property
    def image(self) -> Path:
        """The image that QEMU boots."""
        return self.folder / "boot" / f"vmlinuz-{self.release}"

    @property
    def modules(self) -> Path:
        """Its modules, indexed."""
        return self.folder / "lib" / "modules" / self.release


def find(cache: Path) -> Kernel | None:
    """The kernel in the cache, if one has been set up."""
    for done in sorted(cache.glob("lib/modules/*/modules.dep"), reverse=True):
        return Kernel(cache, done.parent.name)
    return None


def fetch(cache: Path) -> Kernel:
    """Download Debian's current kernel and unpack what the guest needs of it. Raises GuestError."""
    require_amd64_debian()
    depmod = program("depmod")
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=cache) as scratch:
        download, unpacked = Path(scratch) / "download", Path(scratch) / "unpacked"
        download.mkdir()
        unpacked.mkdir()
        _call(["apt-get", "download", "-qq", "-o", "APT::Sandbox::User=root", _package()], download)
        package = next(download.glob("*.deb"))
        patterns = ["./boot/vmlinuz-*", "./lib/modules/*/modules.*"]
        patterns += [f"./lib/modules/*/kernel/{part}" + ("" if "*" in part else "/*") for part in WANTED]
        with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", package], stdout=subprocess.PIPE) as tar:
            subprocess.run(["tar", "x", "-C", unpacked, "--wildcards", *patterns], stdin=tar.stdout, check=True)
        release = next(unpacked.glob("lib/modules/*")).name
        _call([depmod, "-b", str(unpacked), release], unpacked)
        for part in ("boot", "lib"):
            shutil.rmtree(cache / part, ignore_errors=True)
            (unpacked / part).rename(cache / part)
    return Kernel(cache, release)


def write_initramfs(kernel: Kernel, path: Path) -> None:
    """Pack the initramfs: busybox, the modules loaded at boot with all they depend on, and init.sh."""
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        for name in ("bin", "proc", "sys", "dev", "host", "overlay", "newroot", "modules"):
            (root / name).mkdir()
        shutil.copy(program("busybox"), root / "bin" / "busybox")
        for number, module in enumerate(_with_dependencies(kernel)):
            shutil.copy(module, root / "modules" / f"{number:02d}-{module.name}")
        shutil.copy(INIT, root / "init")
        (root / "init").chmod(0o755)
        (root / "modules.host").write_text(f"{kernel.modules}\n")
        names = "\n".join(str(one.relative_to(root)) for one in sorted(root.rglob("*")))
        with path.open("wb") as archive:
            pack = [program("cpio"), "-o", "-H", "newc", "--quiet"]
            subprocess.run(pack, cwd=root, input=names.encode(), stdout=archive, check=True)


def _with_dependencies(kernel: Kernel) -> list[Path]:
    """Files of the modules loaded at boot, each after those that it needs, by depmod's table."""
    lines = (kernel.modules / "modules.dep").read_text().splitlines()
    needs = {name: rest.split() for name, _, rest in (line.partition(":") for line in lines)}
    by_name = {Path(name).name.partition(".")[0].replace("-", "_"): name for name in needs}
    order: dict[str, None] = {}
    for module in AT_BOOT:
        if module in by_name:  # otherwise it is built in
            name = by_name[module]
            order |= dict.fromkeys([*reversed(needs[name]), name])
    return [kernel.modules / name for name in order]


def _package() -> str:
    """The package on which the metapackage depends, e.g. linux-image-6.1.0-40-amd64."""
    shown = subprocess.run(["apt-cache", "depends", METAPACKAGE], capture_output=True, text=True, check=False)
    names = [line.split()[-1] for line in shown.stdout.splitlines() if line.strip().startswith("Depends:")]
    if not names:
        raise GuestError(f"apt knows no {METAPACKAGE}; as root: apt-get update")
    return names[0]


def _call(command: list[str], folder: Path) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        reason = " ".join(done.stderr.split()) or f"exit code {done.returncode}"
        raise GuestError(f"{command[0]} failed: {reason}")
