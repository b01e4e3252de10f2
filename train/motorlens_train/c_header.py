"""A sensor as one C99 header for microcontrollers: the step with its state, no library beyond <math.h>, no allocation.

The state is double whatever the arithmetic of the network: a 900 s filter in float stalls 54 % short at 10 kHz.
"""

from collections.abc import Sequence

import numpy as np

from motorlens_train.features import wiring
from motorlens_train.observer.file import TIME, WINDOW, Observer
from motorlens_train.observer.program import Program
from motorlens_train.sensor import Sensor
from motorlens_train.specification import Array, Bank

_C = {
    "add": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "div": "{0} / {1}", "neg": "-{0}", "pow": "pow({0}, {1})",
    "sqrt": "sqrt({0})", "exp": "exp({0})", "log": "log({0})", "tanh": "tanh({0})", "sin": "sin({0})", "cos": "cos({0})",
    "abs": "fabs({0})", "max": "({0} > {1} ? {0} : {1})", "min": "({0} < {1} ? {0} : {1})",
    "sign": "({0} > 0.0 ? 1.0 : {0} < 0.0 ? -1.0 : 0.0)", "le": "({0} <= {1} ? 1.0 : 0.0)",
    "select": "({0} != 0.0 ? {1} : {2})",
}  # fmt: skip
_SIGNALS = {
    "one": "1.0", "voltage": "voltage", "current": "current", "ambient": "ambient", "current_squared": "current * current",
    "voltage_squared": "voltage * voltage", "power": "voltage * current", "emf": "emf", "emf_squared": "emf * emf",
    "emf_power": "emf * current",
}  # fmt: skip
_ACTIVATIONS = {
    "tanh": "TANH(z)",
    "logistic": "ONE / (ONE + EXP(-z))",
    "rectifier": "z > 0 ? z : 0",
    "linear": "z",
}


def c_header(sensor: Sensor, name: str, double: bool = False) -> str:
    """The header.

    Args:
        sensor: what to write.
        name: prefix of every identifier, a C identifier itself.
        double: whether the network, too, computes in double; on a unit without double precision it should not.

    Raises:
        ValueError: an activation that has no C form here.
    """
    bank, architecture = sensor.bank, sensor.network.architecture
    if architecture.activation not in _ACTIVATIONS:
        raise ValueError(f"no C form of the activation {architecture.activation!r}")
    size = bank.observer.size if bank.observer else 0
    counts = {
        "FILTERS": len(bank.filters), "OBSERVER": size, "FEATURES": len(bank.features),
        "OUTPUTS": len(sensor.specification.outputs),
    }  # fmt: skip
    upper = name.upper()
    outputs = ", ".join(f"{o.name} ({o.unit})" for o in sensor.specification.outputs)
    ambient = ", double ambient" if bank.ambient else ""
    observed = _observer(bank.observer, name) if bank.observer else ""
    return f"""/* {sensor.name}: virtual sensor of a brushed DC motor, written by motorlens. C99.
 *
 *   {name}_state state = {{0}};
 *   {name}_real estimate[{upper}_OUTPUTS], sigma[{upper}_OUTPUTS];
 *   {name}_step(&state, voltage, current{", ambient" if bank.ambient else ""}, dt, estimate, sigma);
 *
 * Volts, amperes, seconds since the previous sample; estimates and one standard deviation of each: {outputs}.
 * Give finite numbers only. A state of zeros is a fresh sensor.
 */
#ifndef {upper}_H
#define {upper}_H
#include <math.h>

{chr(10).join(f"#define {upper}_{key} {value}" for key, value in counts.items())}

typedef {"double" if double else "float"} {name}_real;
typedef struct {{ double filter[{max(counts["FILTERS"], 1)}]; double observer[{max(size, 1)}]; }} {name}_state;

{_tables(sensor, name)}
{observed}
static inline void {name}_step({name}_state *state, double voltage, double current{ambient}, double dt,
                               {name}_real *estimate, {name}_real *sigma) {{
{_features(bank, name)}
{_network(sensor, name, double)}
}}

#endif
"""


def _number(value: float) -> str:
    if not np.isfinite(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return f"({float(value)!r})" if value < 0 else repr(float(value))


def _table(kind: str, name: str, values: Array) -> str:
    flat = np.asarray(values, dtype=np.float64).reshape(-1)
    numbers = [repr(float(value)) for value in flat] or ["0.0"]
    lines = [", ".join(numbers[k : k + 8]) for k in range(0, len(numbers), 8)]
    return f"static const {kind} {name}[] = {{\n  " + ",\n  ".join(lines) + "};"


def _tables(sensor: Sensor, name: str) -> str:
    bank, real = sensor.bank, f"{name}_real"
    plus, minus = wiring(bank)
    index = [f"static const int {name}_{label}[] = {{{', '.join(map(str, values))}}};"
             for label, values in (("plus", plus), ("minus", minus))]  # fmt: skip
    return "\n".join(
        [
            _table("double", f"{name}_tau", np.array([f.tau_s for f in bank.filters])),
            *index,
            # Whitening takes small differences of large features, so it stays in double.
            _table("double", f"{name}_mean", sensor.inputs.mean.numpy()),
            _table("double", f"{name}_whiten", sensor.inputs.matrix.numpy()),
            _table(real, f"{name}_hidden", sensor.network.hidden.numpy()),
            _table(real, f"{name}_output", sensor.network.output.numpy()),
            _table(real, f"{name}_basis", sensor.posterior.basis.numpy()),
            _table(real, f"{name}_variances", sensor.posterior.variances.numpy()),
            _table(real, f"{name}_noise", sensor.noise.numpy()),
            _table("double", f"{name}_scale", sensor.targets.deviation.numpy()),
            _table("double", f"{name}_offset", sensor.targets.mean.numpy()),
        ]
    )


def _observer(observer: Observer, name: str) -> str:
    return "\n".join(
        f"static inline void {name}_{label}(const double *x, double *y) {{\n{_body(program)}\n}}\n"
        for label, program in (
            ("accumulate", observer.accumulate), ("correct", observer.correct), ("read", observer.read),
        )
    )  # fmt: skip


def _body(program: Program) -> str:
    lines = [f"const double r{k} = x[{k}]; (void)r{k};" for k in range(len(program.inputs))]
    lines += [f"const double {line};" for line in program.lines(_C, "r", _number)]
    lines += [f"y[{k}] = {program.result(k, 'r', _number)};" for k in range(len(program.outputs))]
    return "\n".join("  " + line for line in lines)


def _features(bank: Bank, name: str) -> str:
    signals = bank.signals
    filters, observed = len(bank.filters), len(bank.observer.outputs) if bank.observer else 0
    width = len(signals) + filters + 1 + observed
    lines = [f"  double known[{width}];"]
    if any(signal.startswith("emf") for signal in signals):
        lines.append(f"  const double emf = voltage - {_number(bank.resistance_ohm)} * current;")
    lines += [f"  known[{k}] = {_SIGNALS[signal]};" for k, signal in enumerate(signals)]
    if filters:
        drive = ", ".join(str(signals.index(f.signal)) for f in bank.filters)
        lines += [
            f"  static const int drive[] = {{{drive}}};",
            f"  for (int k = 0; k < {filters}; k++) {{",
            "    const double u = known[drive[k]];",
            f"    state->filter[k] = u + (state->filter[k] - u) * exp(-dt / {name}_tau[k]);",
            f"    known[{len(signals)} + k] = state->filter[k];",
            "  }",
        ]
    lines.append(f"  known[{len(signals) + filters}] = 0.0;")
    if bank.observer:
        lines += _sample(bank.observer, bank.ambient, name, width - observed)
    count = len(bank.features)
    lines += [
        f"  double feature[{count}];",
        f"  for (int k = 0; k < {count}; k++) feature[k] = known[{name}_plus[k]] - known[{name}_minus[k]];",
    ]
    return "\n".join(lines)


def _sample(observer: Observer, ambient: bool, name: str, place: int) -> Sequence[str]:
    window, size = len(WINDOW), observer.size
    return [
        "  {",
        f"    const double surroundings = {'ambient' if ambient else _number(observer.ambient_C)};",
        f"    double sample[{4 + window}] = {{voltage, current, surroundings, dt}}, whole[{1 + size}];",
        f"    for (int k = 0; k < {window}; k++) sample[4 + k] = state->observer[k];",
        f"    {name}_accumulate(sample, state->observer);",
        "    whole[0] = surroundings;",
        f"    for (int k = 0; k < {size}; k++) whole[1 + k] = state->observer[k];",
        f"    if (state->observer[{TIME}] >= {observer.full_s!r}) {{",
        f"      {name}_correct(whole, state->observer);",
        f"      for (int k = 0; k < {size}; k++) whole[1 + k] = state->observer[k];",
        "    }",
        f"    {name}_read(whole, known + {place});",
        "  }",
    ]


def _network(sensor: Sensor, name: str, double: bool) -> str:
    """Whitening, layers, output and deviation; the buffer z holds the constant, the inputs and all hidden units."""
    architecture, suffix = sensor.network.architecture, "" if double else "f"
    real, F, K = f"{name}_real", architecture.inputs, architecture.outputs
    activation = _ACTIVATIONS[architecture.activation]
    for word, spelled in (("TANH", f"tanh{suffix}"), ("EXP", f"exp{suffix}"), ("ONE", f"({real})1")):
        activation = activation.replace(word, spelled)
    lines = [
        f"  {real} z[{architecture.columns}];",
        "  z[0] = 1;",
        f"  for (int k = 0; k < {F}; k++) {{",
        "    double sum = 0.0;",
        f"    for (int j = 0; j < {F}; j++) sum += (feature[j] - {name}_mean[j]) * {name}_whiten[j * {F} + k];",
        f"    z[1 + k] = ({real})sum;",
        "  }",
    ]
    weight = 0
    for layer, width in enumerate(architecture.hidden):
        start, reads = architecture.start(layer), architecture.reads(layer)
        # What a layer reads is one stretch of the buffer, and the constant.
        first = reads[1] if len(reads) > 1 else 1
        lines += [
            f"  for (int k = 0; k < {width}; k++) {{",
            f"    const {real} *weight = {name}_hidden + {weight} + k * {len(reads)};",
            f"    {real} net = weight[0];",
            f"    for (int j = 1; j < {len(reads)}; j++) net += weight[j] * z[{first - 1} + j];",
            f"    z[{start} + k] = {activation.replace('z', 'net')};",
            "  }",
        ]
        weight += width * len(reads)
    reads = architecture.reads(architecture.layers)
    first, Z, directions = reads[1], len(reads), sensor.posterior.basis.shape[1]
    low, high = (f"({real}){limit}" for limit in (-25.0, 10.0))
    lines += [
        f"  {real} along[{directions}];",
        f"  for (int d = 0; d < {directions}; d++) {{",
        f"    {real} sum = {name}_basis[d];",
        f"    for (int j = 1; j < {Z}; j++) sum += z[{first - 1} + j] * {name}_basis[j * {directions} + d];",
        "    along[d] = sum * sum;",
        "  }",
        f"  for (int k = 0; k < {K}; k++) {{",
        f"    {real} sum = {name}_output[k * {Z}], noise = {name}_noise[k * {Z}], variance = 0;",
        f"    for (int j = 1; j < {Z}; j++) {{",
        f"      sum += {name}_output[k * {Z} + j] * z[{first - 1} + j];",
        f"      noise += {name}_noise[k * {Z} + j] * z[{first - 1} + j];",
        "    }",
        f"    for (int d = 0; d < {directions}; d++) variance += along[d] * {name}_variances[k * {directions} + d];",
        f"    noise = noise < {low} ? {low} : noise > {high} ? {high} : noise;",
        f"    const double value = (double)sum * {name}_scale[k] + {name}_offset[k];",
        f"    const double deviation = (double)sqrt{suffix}(variance + exp{suffix}(noise)) * {name}_scale[k];",
    ]
    if sensor.frame is None:
        lines += [f"    estimate[k] = ({real})value;", f"    sigma[k] = ({real})deviation;"]
    else:
        columns = [", ".join(map(str, c)) for c in (sensor.frame.estimates, sensor.frame.log_variances)]
        lines += [
            f"    static const int base[] = {{{columns[0]}}}, spread[] = {{{columns[1]}}};",
            "    const double share = exp(0.5 * feature[spread[k]]);",
            f"    estimate[k] = ({real})(feature[base[k]] + share * value);",
            f"    sigma[k] = ({real})(share * deviation);",
        ]
    return "\n".join([*lines, "  }"])
