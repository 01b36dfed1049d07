"""Several estimators on one recording: what each predicts of data it never saw, and of models.

Two kinds of column, kept apart because they prove different things:

    measured     the identification (seen by every fit: proves nothing by itself), and the
                 validation, which no fit saw
    simulated    inputs that were never played, against a grey box that was fitted to this same
                 recording: how an estimator would carry over if the rig were that model. The grey
                 box's own agreement with the validation says how far to trust these.

Each column is judged over its first samples, at most `MEASURED` or `SIMULATED`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from servo_bench.errors import FitError
from servo_bench.estimators.correlation import MeasuredKernels
from servo_bench.estimators.data import SETTLING, Array, Predictor, Training
from servo_bench.estimators.figures import KernelFigures, posterior_figures
from servo_bench.estimators.greybox import GreyBox, GreyBoxModel, SecondOrderPlay
from servo_bench.estimators.registry import estimator
from servo_bench.estimators.regularised import MultilinearPosterior
from servo_bench.estimators.unseen import PredictionMatrix, prediction_matrix, unseen_inputs
from servo_bench.excitation.sequences import MultiAmplitude
from servo_bench.kernels.analysis import Analysis
from servo_bench.kernels.identification import locate_amplitudes
from servo_bench.kernels.labels import ElementLabels
from servo_bench.kernels.predict import vaf_percent
from servo_bench.kernels.response import response_of
from servo_bench.recording.recording import Recording

PAPERS_METHOD = "correlation"
GREY_BOX = "grey-box"
MEASURED, SIMULATED = 2048, 300
REFERENCE_SAMPLES = 4096
"""Of the identification, that the grey box of the simulated columns is fitted to."""

GUESSED_HALF_GAP_RAD = 0.01
SEED = 1
"""Of the inputs that were never played."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """An estimator on the recording, or the reason why it cannot be fitted to it.

    VAF in percent of measured data; NaN where there was none. `deviation_rad_s` is the root mean
    square of the standard deviation that it gives its prediction of the validation.
    """

    name: str
    predictor: Predictor | None
    refused: str
    vaf_same_percent: float
    vaf_fresh_percent: float
    deviation_rad_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """`simulated` and `reference` are None where no grey box could be fitted.

    `posterior` holds the regularised kernels, where they were asked for and the sequence was an
    M-sequence.
    """

    analysis: Analysis
    fits: tuple[Fit, ...]
    reference: Fit | None
    simulated: PredictionMatrix | None
    posterior: KernelFigures | None
    labels: ElementLabels

    @property
    def best(self) -> Fit | None:
        """The largest VAF on the validation; None without one."""
        known = [fit for fit in self.fits if np.isfinite(fit.vaf_fresh_percent)]
        return max(known, key=lambda fit: fit.vaf_fresh_percent, default=None)

    def numbers(self) -> dict[str, Any]:
        """The analysis' figures, and each estimator's, ready for JSON."""
        reference = self.reference
        return {
            **self.analysis.numbers(),
            "estimators": {fit.name: _numbers(fit) for fit in self.fits},
            "against_grey_box": self.simulated.numbers() if self.simulated else None,
            "grey_box": _numbers(reference) if reference else None,
        }


def default_estimators(analysis: Analysis) -> tuple[str, ...]:
    """The paper's method, and what served best on fresh input of that kind of sequence."""
    if analysis.played.kind == "m-sequence" and analysis.amplitudes == 1:
        return (PAPERS_METHOD, "regularised")
    return (PAPERS_METHOD, GREY_BOX)


def study(
    recording: Recording,
    analysis: Analysis,
    names: Sequence[str] = (),
    memory: int | None = None,
) -> Study:
    """Fit the estimators of these names (default: two), with that memory or their own, and judge
    them.

    ConfigError where a name is unknown; an estimator that cannot use this recording is kept with
    its reason.
    """
    chosen = tuple(dict.fromkeys(names)) or default_estimators(analysis)
    model = rig_model(recording)
    makers = {name: estimator(name, memory, model) for name in chosen}  # unknown names end here
    training = training_of(recording, analysis)
    data = _Data(recording, analysis, training)
    fits = []
    for name, maker in makers.items():
        try:
            if name == PAPERS_METHOD:
                fits.append(data.judged(name, MeasuredKernels(analysis.kernels)))
            else:
                fits.append(data.judged(name, maker.fit(training)))
        except FitError as error:
            fits.append(_refused(name, error))
    named = {fit.name: fit for fit in fits}
    reference = named.get(GREY_BOX) or _reference(data, model)
    fitted = {fit.name: fit.predictor for fit in fits if fit.predictor is not None}
    posterior = next((p for p in fitted.values() if isinstance(p, MultilinearPosterior)), None)
    variance = float(np.var(analysis.identification.measured))
    return Study(
        analysis=analysis,
        fits=tuple(fits),
        reference=reference,
        simulated=_simulated(fitted, reference, analysis),
        posterior=None
        if posterior is None
        else posterior_figures(posterior, variance, analysis.kernels.period_s),
        labels=analysis.played.labels(analysis.kernels.memory, analysis.amplitudes),
    )


def rig_model(recording: Recording) -> SecondOrderPlay:
    """The paper's model to start from: the recording's own rig where it is described."""
    nominal = recording.rig.nominal if recording.rig is not None else None
    frequency, half_gap = 0.5 / recording.period_s, GUESSED_HALF_GAP_RAD
    if nominal is not None:
        stiffness = nominal.integral_gain_a_per_rad * nominal.torque_constant_nm_per_a
        frequency = float(np.sqrt(stiffness / nominal.inertia_kg_m2))
        half_gap = nominal.backlash_gap_rad / 2.0 or half_gap
    return SecondOrderPlay(recording.period_s, frequency, half_gap, integrates=True)


def training_of(recording: Recording, analysis: Analysis) -> Training:
    """The mean period in steady state; of several amplitudes the whole play, slot by slot."""
    experiment = recording.experiment
    if experiment is not None and isinstance(experiment.identification, MultiAmplitude):
        response = response_of(recording)
        found, _ = locate_amplitudes(response, experiment.identification)
        begin, end, delay = found[0].start, found[-1].stop, analysis.delay_periods
        commands = response.command_rad_s - analysis.bias_rad_s
        answers = response.velocity_rad_s[begin + delay : end + delay]
        return Training(
            inputs=commands[begin : begin + answers.size].copy(),
            response=answers.copy(),
            history=commands[max(begin - SETTLING, 0) : begin].copy(),
            amplitude=analysis.kernels.amplitude,
        )
    amplitude = analysis.kernels.amplitude
    chips = amplitude * analysis.played.chips
    binary = analysis.played.kind == "m-sequence"
    return Training(
        inputs=chips,
        response=analysis.identification.measured.copy(),
        history=np.resize(chips[::-1], SETTLING)[::-1].copy(),
        polynomial=analysis.played.polynomial if binary else None,
        amplitude=amplitude,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """The recording's own columns."""

    recording: Recording
    analysis: Analysis
    training: Training

    def judged(self, name: str, predictor: Predictor) -> Fit:
        seen = self.training.inputs[:MEASURED]
        same = vaf_percent(
            self.training.response[:MEASURED], predictor.predict(seen, self.training.history)
        )
        fresh = deviation = float("nan")
        validation = self.analysis.validation
        if validation is not None:
            inputs, history = self._validation_inputs(validation.first_slot)
            inputs = inputs[: validation.velocity.measured.size][:MEASURED]
            judged = validation.velocity.judged[: inputs.size]
            measured = validation.velocity.measured[: inputs.size]
            predicted = predictor.predict(inputs, history)
            fresh = vaf_percent(measured[judged], predicted[judged])
            some = predictor.standard_deviation(inputs[:SIMULATED], history)
            deviation = float(np.sqrt(np.mean(some**2)))
        return Fit(name, predictor, "", same, fresh, deviation)

    def _validation_inputs(self, first_slot: int) -> tuple[Array, Array]:
        commands = response_of(self.recording).command_rad_s - self.analysis.bias_rad_s
        begin = first_slot - self.analysis.delay_periods
        return commands[begin:], commands[max(begin - SETTLING, 0) : begin]


def _reference(data: _Data, model: SecondOrderPlay) -> Fit | None:
    """A grey box that nobody asked for; None where it cannot be fitted."""
    whole = data.training
    part = Training(
        whole.inputs[:REFERENCE_SAMPLES].copy(),
        whole.response[:REFERENCE_SAMPLES].copy(),
        whole.history.copy(),
    )
    try:
        return data.judged(GREY_BOX, GreyBox(model).fit(part))
    except FitError:
        return None


def _simulated(
    fitted: Mapping[str, Predictor], reference: Fit | None, analysis: Analysis
) -> PredictionMatrix | None:
    if reference is None or not isinstance(reference.predictor, GreyBoxModel):
        return None
    binary = analysis.played.kind == "m-sequence"
    inputs = unseen_inputs(
        SEED,
        analysis.kernels.amplitude,
        analysis.played.polynomial if binary else None,
        SIMULATED,
    )
    plant = reference.predictor.predict
    others = {name: fit for name, fit in fitted.items() if name != GREY_BOX}
    return prediction_matrix(others, plant, inputs) if others else None


def _refused(name: str, error: FitError) -> Fit:
    nothing = float("nan")
    return Fit(name, None, str(error), nothing, nothing, nothing)


def _numbers(fit: Fit) -> dict[str, Any]:
    known = {
        "vaf_same_percent": fit.vaf_same_percent,
        "vaf_fresh_percent": fit.vaf_fresh_percent,
        "deviation_rad_s": fit.deviation_rad_s,
    }
    numbers = {name: value if np.isfinite(value) else None for name, value in known.items()}
    return {**numbers, "refused": fit.refused or None}
