"""The rig's model: three blocks, effects, and one compiled page that runs them all.

page        the page's text: the skeleton with every effect written in
skeleton    the rig step after step; propagator, contact, play, saturated, lesser: its numerics
engine      the page compiled, and kept
model       Model: nominal values and effects; simulate, simulate_many
blocks      controller, mechanics, transmission alone
plant       ModelPlant: the same slot by slot, for the wire
"""

from sim_rig.model.blocks import MotorMotion, controller, mechanics, transmission
from sim_rig.model.model import LONGEST_STEP_S, Model, simulate_many
from sim_rig.model.plant import ModelPlant
from sim_rig.model.state import ModelState, Simulated

__all__ = [
    "LONGEST_STEP_S",
    "Model",
    "ModelPlant",
    "ModelState",
    "MotorMotion",
    "Simulated",
    "controller",
    "mechanics",
    "simulate_many",
    "transmission",
]
