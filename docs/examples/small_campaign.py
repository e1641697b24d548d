"""A small campaign: one scenario with five seeds, and what became of the runs."""

import hil

if __name__ == "__main__":  # with processes > 1 each process imports this file
    result = hil.campaign("pump_loss", seeds=5, duration_s=230.0)
    for row in result.rows:
        print(f"seed {row.seed}: found after {row.detection_s:.1f} s, named rightly: {row.right}")
    for faults in result.classes():
        print(f"{faults.label}: {faults.detected:.0%} found, median delay {faults.detection.median:.2f} s")
    print("broken invariants:", len(result.broken))
