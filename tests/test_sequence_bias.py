"""An identification that was played with a bias, or with another kind of sequence."""

from dataclasses import replace

import pytest

from servo_bench.errors import FitError
from servo_bench.excitation.experiment import Experiment
from servo_bench.kernels.analysis import analyse
from tests.played_rig import Rig, experiment

BIAS_RAD_S = 0.6


def played_with(**changes: object) -> Experiment:
    """The paper's experiment on 15341 with another identification, bias on the validation too."""
    plain = experiment("15341", memory=18, fresh=1024)
    table = plain.model_dump(mode="json")
    table["identification"] |= changes
    table["validation"] |= {"bias_rad_s": changes.get("bias_rad_s", 0.0)}
    return Experiment.model_validate(table)


def test_a_bias_is_taken_off_the_commands_before_kernels_are_told() -> None:
    """On a linear rig it moves the constant and nothing else."""
    linear = Rig(gap_rad=0.0, counts_per_revolution=None)
    plain = analyse(linear.record(played_with()))
    biased = analyse(linear.record(played_with(bias_rad_s=BIAS_RAD_S)))
    assert biased.kernels.amplitude == pytest.approx(plain.kernels.amplitude)
    assert biased.kernels.g1 == pytest.approx(plain.kernels.g1, abs=1e-9)
    moved = biased.kernels.constant - plain.kernels.constant
    assert moved == pytest.approx(BIAS_RAD_S, rel=1e-3)
    assert biased.validation is not None
    assert biased.validation.velocity.vaf_order1_percent > 99.0


@pytest.mark.parametrize(
    "changes",
    [
        {"kind": "inverse-repeat", "polynomial": "15341"},
        {"kind": "field", "field": 3, "degree": 8, "polynomial": ""},
    ],
    ids=lambda changes: str(changes["kind"]),
)
def test_another_kind_of_sequence_is_refused_and_never_read_as_an_m_sequence(
    changes: dict[str, object],
) -> None:
    table = played_with().model_dump(mode="json")
    table["identification"] = {"amplitude_rad_s": 2.0, **changes}
    recording = Rig(gap_rad=0.0).record(Experiment.model_validate(table))
    found = analyse(recording, memory=6)
    assert found.played.kind == changes["kind"]
    plain = replace(recording, experiment=played_with(amplitude_rad_s=2.0))
    with pytest.raises(FitError, match="are not the M-sequence of 15341"):
        analyse(plain)
