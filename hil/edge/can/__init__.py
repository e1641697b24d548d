"""CAN buses: SocketCAN, slcan adapters, an in-process pair for lockstep."""
