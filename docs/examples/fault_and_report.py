"""Play a fault, see what the diagnosis says of it and when, and write the report of the run."""

import hil

result = hil.simulate("pump_loss", duration_s=260.0)

for fault in result.settings["scenario"]["fault"]:
    print(f"played:   {fault['kind']} {fault['target']} = {fault['value']} at {fault['at_s']:.1f} s")
for alarm in result.alarms:
    print(f"reported: {alarm.kind} {alarm.target} = {alarm.size:.3f} +- {alarm.size_std:.3f}")
    print(f"          detected at {alarm.detected_s:.1f} s, isolated at {alarm.isolated_s:.1f} s")
print("report:  ", result.report("pump_loss.html"))
