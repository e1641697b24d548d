"""A guest kernel with real SocketCAN, for hosts whose kernel has none: Debian's kernel under QEMU, on the host's files.

    python -m tools.guest setup              fetch the kernel, once
    python -m tools.guest run -- CMD...      boot, run one command in the current folder as root, power off
    python -m tools.guest test               tests marked socketcan: on the host if it has AF_CAN, else in the guest
    python -m tools.guest packages           the Debian packages it needs

The guest sees the host's root read-only, under a temporary overlay, so that the virtual environment and the tests
run as they are. It has vcan, and can0 and can1 on two emulated Kvaser PCI cards (SJA1000) wired to one bus. QEMU
translates each instruction: Python takes about twenty times as long. The cards model neither acknowledgement nor bit
rate.
"""
