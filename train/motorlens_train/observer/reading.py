"""What an observer says when it is asked: estimates, their deviations, and whether it is to be believed."""

from typing import Any

from motorlens_train.observer.algebra import dot, mixed, probability
from motorlens_train.observer.belief import HOLD_KNOWN, TOLERANCE, doubt, open_resistance
from motorlens_train.observer.cold import CERTAIN, another_likelier, track_of, weighed
from motorlens_train.observer.file import MEMORY, WINDOW
from motorlens_train.observer.layout import Layout
from motorlens_train.observer.program import Program, Recorder

# No observer is better than this share of the rating plate; below it, its sureness says nothing.
FLOOR = {"speed": 2e-4, "temperature": 2e-3, "resistance": 2e-3}


def read(layout: Layout) -> tuple[tuple[str, ...], Program]:
    """Names of the outputs, and the program (ambient, state) -> outputs."""
    r = Recorder()
    ambient = r.input("ambient")
    window = dict(zip(WINDOW, r.inputs(WINDOW), strict=True))
    memory = dict(zip(MEMORY, r.inputs(MEMORY), strict=True))
    restless = memory["restless"]
    known, common = layout.sensitivities(r), layout.common(r)
    track = track_of(layout, r)
    changing = probability(memory["odds"] + layout.odds)
    x, P = mixed(changing, layout.unpack(r))
    n = len(layout.states)
    # What is not known of how the voltage runs between samples is not known of the states.
    V, information, _ = known["hold"]
    P = [[P[a][b] + V[a] * V[b] / (information + HOLD_KNOWN) for b in range(n)] for a in range(n)]
    w, theta = layout.at["w"], layout.at["theta"]
    mean = 0.5 * (window["current"] + window["current_start"])
    rates, A = layout.linearised(r, x, mean, window["voltage"], ambient)
    # Since the window began the speed has run on, by what is not known of the load as well.
    run_on = [A[w][j] * window["time"] + (1.0 if j == w else 0.0) for j in range(n)]
    outputs: dict[str, Any] = {"speed": x[w] + rates[w] * window["time"], "temperature": x[theta]}
    outputs["resistance"] = layout.resistance(r, x)
    variances = {
        "speed": dot(run_on, [dot(row, run_on) for row in P]),
        "temperature": P[theta][theta],
        "resistance": layout.resistance_variance(r, x, P),
    }
    # Where the slope has not followed the current yet, an error of the resistance is one of the speed.
    behind = (mean - memory["slope"]) * (layout.per_kelvin(x) / layout.motor.ke)
    variances["speed"] = variances["speed"] + behind * behind * P[theta][theta]
    variances["speed"] = variances["speed"] + memory["unseen"] * (9.0 / layout.motor.ke**2)
    # R_a0 that is off by a share moves the temperature by that share of 1/alpha + theta.
    unknown = dict(layout.settings.tolerances).get("R_a0", 0.0)
    per_share = x[theta] + 1 / layout.motor.alpha
    resistive = (
        1.0 if unknown else another_likelier(layout, track, x[theta], P[theta][theta], per_share * TOLERANCE)
    )
    against, grown, own = doubt(
        layout, known, common, window["hold"], memory, x, outputs["resistance"], resistive
    )
    ohms = layout.per_kelvin(x)
    for name, growth in (
        ("speed", grown["w"]), ("temperature", grown["theta"]), ("resistance", ohms * ohms * grown["resistance"])
    ):  # fmt: skip
        variances[name] = variances[name] + growth
    apart = per_share * unknown
    variances["temperature"] = variances["temperature"] + apart * apart
    # A start from ambient temperature, as far as it is borne out; and with the temperature goes what errs along with it.
    filtered = variances["temperature"]
    # As far as the temperature is no longer the first guess, it has been read off the resistance.
    read_off = 1.0 - P[theta][theta] * (1 / layout.sd[theta] ** 2)
    reach = per_share * read_off * (open_resistance(layout) * CERTAIN)
    start = weighed(
        layout, track, x[theta], P[theta][theta] + apart * apart, apart * apart, grown["theta"], own, reach
    )
    along = {"speed": P[w][theta], "temperature": filtered, "resistance": ohms * P[theta][theta]}
    for name, covariance in along.items():
        slope = 1.0 if name == "temperature" else covariance / filtered
        outputs[name] = outputs[name] + slope * start.moves
        variances[name] = variances[name] + slope * slope * (start.variance - filtered)
    variances["temperature"] = start.thermometer
    sizes = {
        "speed": layout.rated.speed_rad_s, "temperature": layout.rated.rise_K,
        "resistance": layout.motor.R_a0 * layout.motor.alpha * layout.rated.rise_K,
    }  # fmt: skip
    outputs["load"] = x[layout.at["load"]]
    for name in layout.states:
        if name not in ("w", "theta", "load"):
            outputs[name] = x[layout.at[name]]
    for name, variance in variances.items():
        outputs[f"log_{name}"] = (variance + (FLOOR[name] * sizes[name]) ** 2).log()
    outputs["correlation"] = P[w][theta] / (P[w][w] * P[theta][theta] + 1e-30).sqrt()
    outputs["changing"] = changing
    # Above 0 is a reason not to believe the rest.
    outputs["distrust"] = against
    # An outlier lifts the average of squares by orders of magnitude; its logarithm stays within reach.
    outputs["restless"] = (restless.max(-0.9) + 1.0).log()
    return tuple(outputs), r.program(list(outputs.values()))
