"""The rig's drive on Modbus: the same drive as on CANopen, its objects in registers."""
