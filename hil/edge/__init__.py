"""Everything that touches the machine: CAN buses, records, configuration files, the host."""
