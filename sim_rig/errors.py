"""What can go wrong in the software rig.

SimRigError
├── RigSettingsError   the settings describe a rig that cannot be
├── EffectError        an effect or a parameter that does not exist, or a value without meaning
└── SimulationError    a simulation that cannot be run, or that ran away
"""


class SimRigError(Exception):
    """Anything the software rig raises on purpose."""


class RigSettingsError(SimRigError):
    """The settings describe a rig that cannot be."""


class EffectError(SimRigError):
    """An effect or a parameter that does not exist, or a value without meaning."""


class SimulationError(SimRigError):
    """A simulation that cannot be run, or that ran away."""
