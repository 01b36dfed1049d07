"""The paper's rig as a Plant: the exact motor, and behind it the play."""

from sim_rig.motor import MotorState, Step, doubling_steps, motor_current_a, step_lengths_us
from sim_rig.plant import PlantOutputs
from sim_rig.play import play
from sim_rig.settings import Nominal

_Row = tuple[float, float, float]


def _rows(step: Step) -> tuple[_Row, _Row, _Row]:
    """(omega, z, r) -> change of theta, omega, z, as plain floats: nine products beat numpy."""
    theta, omega, z = (
        (float(phi[1]), float(phi[2]), float(gamma))
        for phi, gamma in zip(step.phi, step.gamma, strict=True)
    )
    return theta, omega, z


class PaperPlant:
    """PI velocity loop, inertia, rigid play; at rest at angle zero, the load mid-gap.

    Durations are taken to the whole microsecond. With the power stage off there is no current
    and, the ideal rig having no friction, it coasts for ever; the integrator restarts at zero.
    """

    def __init__(self, nominal: Nominal) -> None:
        self._nominal = nominal
        self._steps = {us: _rows(step) for us, step in doubling_steps(nominal).items()}
        self._motor = MotorState()
        self._load_angle_rad = 0.0
        self._command_rad_s: float | None = None

    def advance(self, velocity_command_rad_s: float | None, duration_s: float) -> None:
        """Hold the command for `duration_s`; None means the power stage is off and it coasts."""
        duration_us = round(duration_s * 1e6)
        self._command_rad_s = velocity_command_rad_s
        if velocity_command_rad_s is None:
            self._coast(duration_us)
        else:
            self._drive(velocity_command_rad_s, duration_us)

    def outputs(self) -> PlantOutputs:
        """The present state; changes nothing."""
        theta, omega, z = self._motor
        command = self._command_rad_s
        return PlantOutputs(
            motor_position_rad=theta,
            motor_velocity_rad_s=omega,
            motor_current_a=0.0
            if command is None
            else motor_current_a(self._nominal, command, omega, z),
            load_angle_rad=self._load_angle_rad,
        )

    def _coast(self, duration_us: int) -> None:
        theta, omega, _ = self._motor
        theta += omega * (duration_us * 1e-6)
        self._motor = MotorState(theta, omega, 0.0)
        self._load_angle_rad = play(self._load_angle_rad, theta, self._nominal.backlash_gap_rad)

    def _drive(self, r: float, duration_us: int) -> None:
        theta, omega, z = self._motor
        load, gap = self._load_angle_rad, self._nominal.backlash_gap_rad
        for us in step_lengths_us(duration_us):
            (t_w, t_z, t_r), (w_w, w_z, w_r), (z_w, z_z, z_r) = self._steps[us]
            theta += t_w * omega + t_z * z + t_r * r
            omega, z = w_w * omega + w_z * z + w_r * r, z_w * omega + z_z * z + z_r * r
            load = play(load, theta, gap)
        self._motor = MotorState(theta, omega, z)
        self._load_angle_rad = load


def paper_plant(nominal: Nominal, _seed: int) -> PaperPlant:
    """The factory behind `plant = "paper"`; nothing in it is random."""
    return PaperPlant(nominal)
