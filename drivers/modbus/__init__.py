"""Modbus master: a velocity-commanded drive over TCP or RTU, described by a register map."""
