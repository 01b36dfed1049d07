"""The software rig: the rig's equations, and the slaves that put them on the wire.

Knows neither the bench nor its drivers: what it is told comes over the bus or in its settings.
"""
