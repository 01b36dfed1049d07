"""A model behind the `Plant` protocol: the wire's rig, and the offline simulation, bit for bit."""

from typing import TYPE_CHECKING

import numpy as np

from sim_rig.errors import SimulationError
from sim_rig.model.engine import engine
from sim_rig.model.running import flat_parameters, rig_array, steps_of
from sim_rig.model.skeleton import CLOSED
from sim_rig.model.state import CLOCK, ModelState
from sim_rig.plant import PlantOutputs

if TYPE_CHECKING:
    from sim_rig.model.model import Model


class ModelPlant:
    """Stepped slot by slot by the same compiled page as `Model.simulate`, from rest.

    The rig's clock, by which its friction warms and its command falls behind, begins with the first
    command: a rig may wait for hours until somebody enables it.
    """

    def __init__(self, model: "Model", start: ModelState) -> None:
        machine = engine()
        self._run = machine.run
        self._rig, self._longest_step_s = rig_array(model), steps_of(model)
        self._parameters = flat_parameters(model, machine)
        self._values = np.array(start.values)
        self._row = np.array([start.recorded])
        self._command, self._duration = np.zeros(1), np.zeros(1)
        self._given = np.zeros((1, 4))
        self._begun, self._start_s = False, float(self._values[CLOCK])

    def advance(self, velocity_command_rad_s: float | None, duration_s: float) -> None:
        """Hold the command for `duration_s`; None means the power stage is off and it coasts."""
        self._command[0] = np.nan if velocity_command_rad_s is None else velocity_command_rad_s
        self._duration[0] = round(duration_s * 1e9) * 1e-9
        if not self._run(
            *(self._rig, self._parameters, self._values, self._command, self._duration),
            *(self._given, CLOSED, self._longest_step_s, self._row),
        ):
            raise SimulationError("more than 64 commands are on their way at once.")
        self._begun = self._begun or velocity_command_rad_s is not None
        if not self._begun:
            self._values[CLOCK] = self._start_s

    def outputs(self) -> PlantOutputs:
        """The present state; changes nothing."""
        angle, velocity, current, load = self._row[0, :4].tolist()
        return PlantOutputs(angle, velocity, current, load)

    def state(self) -> ModelState:
        """The present state, to start a simulation from."""
        return ModelState(tuple(self._values.tolist()), tuple(self._row[0].tolist()))
