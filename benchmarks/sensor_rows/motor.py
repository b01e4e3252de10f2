"""Rows on the simulated motor of the sensor: the paper's run, unseen duty cycles, hot restarts, ambient temperature."""

from dataclasses import replace

import numpy as np
from sensor_rows.common import (
    BOUND,
    MELLAH,
    WATCHING,
    WHITE,
    Observing,
    Size,
    duty,
    exact_hybrid,
    exact_material,
    filters,
    goal,
    show,
    trained,
)
from sensor_rows.recurrent import Recurrent

from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs, simulate
from motorlens_train.baselines import (
    ExtendedKalman,
    Method,
    Perceptron,
    SteadyStateVoltage,
    ThermalObserver,
    TwoStepKalman,
)
from motorlens_train.baselines.method import OUTPUTS, UNITS
from motorlens_train.build import Recipe
from motorlens_train.evaluation.scores import Evaluation, counted, evaluate
from motorlens_train.observer.design import with_observer
from motorlens_train.paper import paper_run
from motorlens_train.specification import Bank, Feature, Rate
from motorlens_train.trainer import Settings

GOALS = {"speed": 0.5, "temperature": 0.8, "resistance": 0.012}


def paper(size: Size, quick: bool) -> None:
    """The paper's run and protocol (samples of one run split at random), with the noise of all rows."""
    m = MELLAH.motor
    instant = Bank(m.R_a0, m.L, (), (Feature("raw", "voltage"), Feature("raw", "current")))
    print(
        f"\n## the paper's run and protocol, white noise {WHITE.voltage_V} V and {WHITE.current_A} A a sample"
    )
    for title, bank in (("with history", filters(MELLAH)), ("without: this sample only", instant)):
        settings = Settings(iterations=size.iterations)
        recipe = Recipe("paper", bank, OUTPUTS, (12, 8), Rate(1000.0, 200.0, 2000.0), 1.0, 1, settings)
        found = paper_run(MELLAH, recipe, WHITE, 1)
        steady, whole = found.steady, found.table
        print(f"  {title}: mean square error {found.training_error:.2g} (paper: 1.6e-4)")
        goal("speed after five seconds, largest (rad/s)", steady["speed"]["max"], 0.02)
        goal("speed at the start, largest (rad/s)", whole["speed"]["max"], 11)
        goal("temperature, largest (K)", whole["temperature"]["max"], 0.2)
        goal("resistance, largest (ohm)", whole["resistance"]["max"], 0.001)


def unseen(size: Size, quick: bool) -> None:
    """Which network, on unseen duty cycles of the exact motor with unknown load; coverage by excitation; ladder."""
    bank, cycles = with_observer(filters(MELLAH), MELLAH, WATCHING), exact_material(size)
    methods: dict[str, Method] = {"hybrid": exact_hybrid(size), "observer alone": Observing(bank, MELLAH)}
    methods["cascade alone"] = trained(filters(MELLAH), cycles, size, (12, 8))
    methods["plain feed-forward"] = trained(filters(MELLAH), cycles, size, (12, 8), skips=False)
    methods["recurrent (GRU)"] = Recurrent.trained(cycles, MELLAH, 20 if quick else 60)
    bench = duty(MELLAH, replace(size, testing=3), 21)
    methods["EKF, exact parameters"] = ExtendedKalman(refit=False).fit(bench, MELLAH)
    if not quick:
        others = {
            "two-step Kalman": TwoStepKalman(), "thermal observer": ThermalObserver(), "perceptron": Perceptron(),
            "steady-state voltage": SteadyStateVoltage(),
        }  # fmt: skip
        methods |= {name: method.fit(bench, MELLAH) for name, method in others.items()}
    cases = ("unseen duty cycles from ambient temperature, exact motor, unknown load, 200 Hz", 31, True), (
        "the same from any start temperature", 41, False,
    )  # fmt: skip
    for title, seed, from_ambient in cases:
        show(title, evaluate(methods, duty(MELLAH, size, seed, ambient_start=from_ambient), MELLAH, BOUND))
        # A cycle has one start and shows it well or badly: to judge starts takes more cycles than a ladder of methods.
        many = duty(MELLAH, replace(size, testing=4 * size.testing), seed, ambient_start=from_ambient)
        found = evaluate({"hybrid": exact_hybrid(size)}, many, MELLAH, BOUND)
        goals(found, len(many))


def goals(found: Evaluation, cycles: int) -> None:
    """The goals of unseen duty cycles, for the hybrid."""
    print(f"  the hybrid on {cycles} cycles:")
    for output, score in found.scores["hybrid"].items():
        goal(f"{output}, rms ({UNITS[output]})", score.rms, GOALS[output])
        goal(f"{output}, over the bound", score.ratio, 1.5)
    goal("temperature, largest (K)", found.scores["hybrid"]["temperature"].max, 3.0)
    for output, shares in found.coverage_by_excitation()["hybrid"].items():
        for third, share in zip(("first", "second", "last"), shares, strict=True):
            goal(f"{output}, in the 95 % interval (%), {third} third since excitation", 100 * share, 97, 93)


def hot_restart(size: Size, quick: bool) -> None:
    """Error one second after the first step of at least a fifth of rated voltage, from an unknown 0 to 80 K."""
    errors = []
    for k in range(4 * size.testing):
        rng = np.random.default_rng([51, k])
        n = 1500
        time_s = np.arange(n) * 1e-3
        voltage = np.where(time_s < 0.2, 0.0, MELLAH.rated.voltage_V * rng.uniform(0.2, 1.0))
        load = np.full(n, MELLAH.rated.torque_Nm * rng.uniform(0.0, 1.0))
        run = simulate(
            MELLAH.motor,
            Inputs(time_s, voltage, load, np.full(n, 20.0), held=True),
            {"theta": rng.uniform(0, 80)},
        )
        channels = {
            "voltage": voltage + WHITE.voltage_V * rng.standard_normal(n),
            "current": run.current_A + WHITE.current_A * rng.standard_normal(n),
        }
        seen = exact_hybrid(size).estimate(Recording("hot restart", time_s, channels)).temperature[1200]
        errors.append(abs(seen - run.rise_K[1200]))
    print(
        f"\n## hot restart at unknown 0-80 K, a step of 0.2 to 1 of rated voltage, 1 kHz, {len(errors)} starts\n"
        f"  error one second after the step: rms {np.sqrt(np.mean(np.square(errors))):.2f} K"
    )
    goal("error of nineteen starts in twenty (K)", float(np.quantile(errors, 0.95)), 3.0)
    goal("largest error (K)", float(np.max(errors)), 3.0)


def ambient(size: Size, quick: bool) -> None:
    """The winding's temperature in degC where the ambient one is anywhere in 0 to 40 degC: not known, and measured."""
    errors: dict[str, list[np.ndarray]] = {"not known, taken for 20 degC": [], "measured": []}
    inside: dict[str, list[np.ndarray]] = {name: [] for name in errors}
    for recording in duty(MELLAH, size, 81):
        rows = counted(recording, MELLAH)
        found, c = exact_hybrid(size).estimate(recording), recording.channels
        for name, surroundings, unsure in zip(
            errors, (np.full(len(rows), 20.0), c["ambient"]), (40 / np.sqrt(12), 0.0), strict=True
        ):
            error = (found.temperature + surroundings - c["temperature"])[rows]
            errors[name].append(error)
            inside[name].append(np.abs(error) <= 1.96 * np.hypot(found.temperature_sd[rows], unsure))
    print(
        f"\n## ambient temperature 0 to 40 degC, winding in degC, {size.testing} unseen duty cycles from any start"
    )
    for name in errors:
        rms = np.sqrt(np.mean(np.square(np.concatenate(errors[name]))))
        print(
            f"  ambient {name}: rms {rms:.3g} K, 95 % interval covers {100 * np.concatenate(inside[name]).mean():.1f} %"
        )
