"""The rig's own model with a friction that is felt only when the power is off: it comes to rest."""

import math

from sim_rig.model import Model, ModelPlant
from sim_rig.plant import PlantOutputs
from sim_rig.settings import Nominal

COASTING_S = 0.1


class CoastingPlant:
    """Without power the velocity falls to 1/e in `COASTING_S`."""

    def __init__(self, nominal: Nominal) -> None:
        self._model = Model(nominal)
        self._plant = self._model.plant()

    def advance(self, velocity_command_rad_s: float | None, duration_s: float) -> None:
        """As the model; without power, slowed down afterwards."""
        self._plant.advance(velocity_command_rad_s, duration_s)
        if velocity_command_rad_s is None:
            now = self._plant.outputs()
            slowed = self._model.state(
                motor_angle_rad=now.motor_position_rad,
                motor_velocity_rad_s=now.motor_velocity_rad_s * math.exp(-duration_s / COASTING_S),
                load_angle_rad=now.load_angle_rad,
            )
            self._plant = ModelPlant(self._model, slowed)

    def outputs(self) -> PlantOutputs:
        """The present state; changes nothing."""
        return self._plant.outputs()


def coasting(nominal: Nominal, _seed: int) -> CoastingPlant:
    """The factory for `plant = "tests.coasting_plant:coasting"`."""
    return CoastingPlant(nominal)
