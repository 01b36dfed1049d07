"""What is always there in the truth, in the catalogue's words, and how large at most.

A verdict that names one of these with a size no larger than it really is has said something true:
it counts as not spurious. Beyond the size it is a wrong name.

    0.3e-3 N m friction, 2e-5 N m s/rad drag, 60 us current lag, each +-30 %; K_T and J +-0.2 %;
    a detent and a bearing of 0.1e-3 N m; the loop's wait and its difference of counts, 125 us each
    at most; Hertz's contact and 3e-7 kg m^2 behind the gap
"""

from collections.abc import Mapping
from types import MappingProxyType

from tests.truth.nuisances import SCATTER, Nuisances

_MEAN = Nuisances()
_MOST = 1.0 + SCATTER
_LOOP_S = _MEAN.loop_period_s
_RATIO = 0.004
"""K_T and J are each off by 0.2 % at most, and only their ratio shows."""

_FRICTION_NM = _MOST * _MEAN.motor_friction_nm
_LOAD_FRICTION_NM = _MOST * _MEAN.load_friction_nm

LARGEST: Mapping[tuple[str, str], float] = MappingProxyType(
    {
        ("coulomb", "torque_nm"): _FRICTION_NM + _LOAD_FRICTION_NM,
        ("pre_sliding", "torque_nm"): _FRICTION_NM + _LOAD_FRICTION_NM,
        ("load_friction", "torque_nm"): _LOAD_FRICTION_NM,
        ("viscous", "damping_nm_s_per_rad"): _MOST * _MEAN.motor_viscous_nm_s_per_rad,
        ("cogging", "torque_nm"): _MEAN.detent_nm * _MOST,
        ("torque_constant_error", "error_fraction"): _RATIO,
        ("inertia_error", "error_fraction"): _RATIO,
        ("current_loop_lag", "lag_s"): _MOST * _MEAN.current_lag_s + _LOOP_S,
        ("velocity_filter_lag", "lag_s"): _MOST * _MEAN.current_lag_s + _LOOP_S,
        ("transport_delay", "delay_s"): _MOST * _MEAN.current_lag_s + _LOOP_S,
        ("contact", "compliance_rad_per_nm"): 0.1,
    }
)
"""Effect and parameter, and the largest size that the truth really has. The contact's: at the
torque that carries so light a load, a tenth of a millinewtonmetre, Hertz's secant compliance."""


def is_there(effect: str, parameters: Mapping[str, float]) -> bool:
    """Whether an effect of this size is no more than what every rig of the truth has."""
    sizes = [
        abs(parameters[field]) <= most
        for (name, field), most in LARGEST.items()
        if name == effect and field in parameters
    ]
    return bool(sizes) and all(sizes)
