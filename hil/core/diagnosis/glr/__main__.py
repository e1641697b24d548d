"""`python -m hil.core.diagnosis.glr` compiles the diagnosis now and keeps it on disk, so that no run waits for it."""

from __future__ import annotations

from hil.core.diagnosis.glr.glr_detector import GlrDetector
from hil.core.tanks import TankModel


def compile_ahead() -> None:
    """Compile all of it, unless that has been done: a quarter of a minute. No numbers are built in: any rig will do."""
    GlrDetector(TankModel(), lag_s=0.2, noise_V=0.005)


if __name__ == "__main__":
    compile_ahead()
