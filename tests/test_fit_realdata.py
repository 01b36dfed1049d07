"""A motor on someone else's table: current in, position out, neither inertia nor K_T published.

What can be known is J/K_T, found here a second way: the slope of acceleration over current, by
straight regression on smoothed data.
"""

from functools import cache

import numpy as np
import pytest
from scipy.signal import savgol_filter

from servo_bench.diagnosis.fitting.fit import Fit, fit
from servo_bench.foreign.importing import read_foreign
from servo_bench.foreign.maps import load_map
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from sim_rig.settings import Nominal
from tests.fit_recordings import rows
from tests.foreign_files import measured

PER_KT = Model(Nominal(1.0, 1e-3, 1.0, 1.0))
"""With a K_T of one, torques are currents and J is J/K_T; the gains of a loop are not used."""
FREE = ("J", "viscous.damping_nm_s_per_rad", "coulomb.torque_nm")


def laas() -> Recording:
    """The first 16 s."""
    path = measured("laas_cogging/acc_current.txt")
    whole = read_foreign(path, load_map("maps/laas_cogging.toml"))
    return rows(whole, np.flatnonzero(whole["t_s"] < whole["t_s"][0] + 16.0))


@cache
def fitted(window_s: float) -> Fit:
    return fit(laas(), PER_KT, FREE, window_s=window_s)


def regression(recording: Recording) -> tuple[float, float]:
    """(J, Coulomb) over K_T: current = J a + B w + T sgn w, on an even grid, smoothed."""
    t_s = np.arange(recording["t_s"][0], recording["t_s"][-1], 1e-3)
    angle = np.interp(t_s, recording["t_s"], recording["motor_position_rad"])
    current = np.interp(t_s, recording["t_s"], recording["current_a"])
    smooth = [savgol_filter(angle, 41, 3, deriv=d, delta=1e-3) for d in (1, 2)]
    basis = np.column_stack([smooth[1], smooth[0], np.sign(smooth[0])])
    moving = np.abs(smooth[0]) > 5.0
    current = savgol_filter(current, 41, 3)
    found = np.linalg.lstsq(basis[moving], current[moving])[0]
    return float(found[0]), float(found[2])


@pytest.mark.long
def test_inertia_per_torque_constant_agrees_with_a_regression() -> None:
    inertia, friction = regression(laas())
    found = fitted(1.0)
    assert (found.block, found.window_s) == ("mechanics", 1.0)
    assert found["J"].value == pytest.approx(inertia, rel=0.03)
    assert found["coulomb.torque_nm"].value == pytest.approx(friction, rel=0.25)


@pytest.mark.long
def test_the_windows_length_does_not_matter_for_what_is_well_known() -> None:
    short, long = fitted(0.3)["J"], fitted(1.0)["J"]
    assert short.value == pytest.approx(long.value, rel=0.02)


def test_friction_pays_on_windows_that_no_fit_saw() -> None:
    without = fit(laas(), PER_KT, ("J",))
    with_friction = fitted(1.0).signal("motor velocity").held_out_after
    assert with_friction < 0.5 * without.signal("motor velocity").held_out_after
    assert fitted(1.0)["coulomb.torque_nm"].value > 0.0


def test_what_the_recording_cannot_tell_apart_is_said() -> None:
    """One amplitude at one frequency: damping and friction rise and fall together."""
    (note,) = fitted(1.0).notes
    assert note.startswith("viscous.damping_nm_s_per_rad and coulomb.torque_nm")
    assert "tell apart" in note or "told apart" in note
