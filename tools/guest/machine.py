"""One boot of the guest: runs one command, passes its output on at once, returns its exit code."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

from tools.guest.host import program
from tools.guest.kernel import Kernel, write_initramfs

MEMORY_MB = 1536
CPUS = 1
SESSION = Path(__file__).with_name("session.sh")
CONSOLE_TAIL = 30
NOT_PASSED_ON = frozenset({"PWD", "OLDPWD", "SHLVL", "_", "PATH", "HOME", "TMPDIR", "TMP", "TEMP"})


class GuestLostError(Exception):
    """The guest ended before the command did; the message has its console output."""


def run(kernel: Kernel, command: list[str], limit_s: float) -> int:
    """Boot, run the command in the current folder with this environment, power off; the command's exit code.

    Raises GuestLostError when it ended without one, or ran for longer than limit_s.
    """
    with tempfile.TemporaryDirectory(prefix="guest-") as scratch:
        job, initramfs, console = Path(scratch) / "job", Path(scratch) / "initramfs", Path(scratch) / "console"
        job.mkdir()
        shutil.copy(SESSION, job / "session.sh")
        (job / "command.sh").write_text(_script(command))
        write_initramfs(kernel, initramfs)
        _boot(_qemu(kernel, initramfs, job, console), limit_s, console)
        try:
            return int((job / "exit_code").read_text())
        except (OSError, ValueError):
            raise GuestLostError(f"the guest ended without an exit code; its console:\n{_tail(console)}") from None


def _script(command: list[str]) -> str:
    """The command as a shell script, with this folder and this environment except for the guest's own variables."""
    passed_on = {name: value for name, value in os.environ.items() if name.isidentifier() and name not in NOT_PASSED_ON}
    lines = [f"export {name}={shlex.quote(value)}" for name, value in sorted(passed_on.items())]
    return "\n".join([f"cd {shlex.quote(os.getcwd())} || exit 127", *lines, f"exec {shlex.join(command)}", ""])  # noqa: PTH109


def _qemu(kernel: Kernel, initramfs: Path, job: Path, console: Path) -> list[str]:
    """QEMU's command line. Translated, without KVM, which does not always work where a virtual machine offers it."""
    arguments = f"""
        -accel tcg -icount shift=0,sleep=off -cpu max -machine pc -m {MEMORY_MB} -smp {CPUS}
        -nodefaults -no-user-config -display none -monitor none -no-reboot
        -serial file:{console}
        -chardev file,id=out,path=/proc/self/fd/1,append=on
        -device virtio-serial-pci -device virtserialport,nr=1,chardev=out
        -fsdev local,id=host,path=/,security_model=none,readonly=on,multidevs=remap
        -device virtio-9p-pci,fsdev=host,mount_tag=host
        -fsdev local,id=job,path={job},security_model=none -device virtio-9p-pci,fsdev=job,mount_tag=job
        -object rng-random,id=random,filename=/dev/urandom -device virtio-rng-pci,rng=random
        -object can-bus,id=wire -device kvaser_pci,canbus=wire -device kvaser_pci,canbus=wire
        -kernel {kernel.image} -initrd {initramfs}
    """
    boot = "console=ttyS0 loglevel=4 panic=-1 mitigations=off random.trust_cpu=on tsc=reliable audit=0"
    return [program("qemu-system-x86_64"), *arguments.split(), "-append", boot]


def _boot(qemu: list[str], limit_s: float, console: Path) -> None:
    """Run QEMU to its end, and copy the command's output."""
    with subprocess.Popen(qemu, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as machine:
        is_late = threading.Event()

        def end() -> None:
            is_late.set()
            machine.kill()

        alarm = threading.Timer(limit_s, end)
        alarm.start()
        try:
            while machine.stdout and (piece := os.read(machine.stdout.fileno(), 1 << 16)):
                sys.stdout.buffer.write(piece)
                sys.stdout.flush()
            machine.wait()
        finally:
            alarm.cancel()
            machine.kill()
    if is_late.is_set():
        raise GuestLostError(f"the guest was ended after {limit_s:g} s; its console:\n{_tail(console)}")


def _tail(console: Path) -> str:
    lines = console.read_text(errors="replace").splitlines() if console.exists() else []
    return "\n".join(lines[-CONSOLE_TAIL:])
