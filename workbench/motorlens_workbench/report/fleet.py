"""What `fleet` found: as JSON, for the terminal, and as a page."""

from typing import Any

import numpy as np
from scipy.stats import norm

from motorlens_workbench.fleet.history import Series
from motorlens_workbench.fleet.levels import possible
from motorlens_workbench.fleet.odd import Difference, MakeEffect
from motorlens_workbench.fleet.study import Fleet
from motorlens_workbench.report.page import Page, Section, significant, unit_text
from motorlens_workbench.report.pictures import Bar, Bars, Plot, Table, curves

# Motors shown as bars, and pictures of changes, on the page; tables hold them all.
SHOWN = 20
_POINTS = 200


def verdict(fleet: Fleet) -> str:
    """One sentence: how many, and which are not like the others."""
    found = fleet.population
    count = f"{_count(len(found.motors), 'motor')}, {_count(len(found.observations), 'recording')}"
    names = [found.motors[m] for m in fleet.odd]
    if not names:
        return f"{count}: none differs from the others by more than motors of this make do."
    listed = ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
    return f"{count}: {listed} {'is' if len(names) == 1 else 'are'} not like the others."


def to_text(fleet: Fleet) -> list[str]:
    """Lines for the terminal."""
    lines = [verdict(fleet), *_in_common(fleet)]
    lines += [
        f"{fleet.population.motors[m]}: {sentence}" for m in fleet.odd for sentence in differences(fleet, m)
    ]
    lines += [change_sentence(series) for series in changed(fleet)]
    lines += [f"{motor}: {sentence}" for motor, sentence in _diagnoses(fleet)]
    lines.append("")
    head = ("parameter", "make", "+-", "between motors", "between recordings", "unit")
    lines.append(f"{head[0]:32}{head[1]:>12}{head[2]:>10}{head[3]:>16}{head[4]:>20}  {head[5]}")
    for key, value, sd, between, within, unit in _population_rows(fleet):
        lines.append(f"{key:32}{significant(value):>12}{sd:10.2g}{between:>16}{within:>20}  {unit}")
    lines += [f"{outcome.entry.name}: {outcome.failure}" for outcome in fleet.failed]
    return lines


def history_lines(fleet: Fleet, motor: str) -> list[str]:
    """One motor over its dates."""
    mine = [series for series in fleet.histories if series.motor == motor]
    if not mine:
        return [f"{motor}: fewer than four dated recordings; nothing can be said of its history"]
    lines = []
    for series in mine:
        lines.append(change_sentence(series) if series.change else f"{motor}: no change of {series.key}")
        for date, value, sd in zip(series.dates, series.value, series.sd, strict=True):
            lines.append(
                f"    {date:%Y-%m-%d}  {significant(float(value)):>10} +- {sd:.2g} {unit_text(series.unit)}".rstrip()
            )
    return lines


def to_json(fleet: Fleet, motor: str) -> dict[str, Any]:
    """The document of `--json`, schema motorlens.fleet/1."""
    found = fleet.population
    values, sds = found.of_motors()
    _, alone = found.alone()
    low, high = found.interval()
    mean, mean_sd = found.mean()
    adds = _adds(fleet)
    used = iter(range(len(found.observations)))
    return {
        "schema": "motorlens.fleet/1",
        "motor": motor,
        "effects_of_the_make": [_effect_json(effect) for effect in fleet.effects],
        "sensor_faults_of_all": [_effect_json(fault) for fault in fleet.faults],
        "lacks": _effect_json(found.lacks) if found.lacks else None,
        "brief": {"seconds": fleet.make.brief_s, "led_away": led_away(fleet)} if fleet.brief else None,
        "population": {
            key: {
                "value": float(mean[k]), "sd": float(mean_sd[k]), "unit": found.file.meaning(key).unit,
                "spreads_are": "shares" if found.scale.relative[k] else "in the unit",
                "between_motors": float(found.spreads.omega[k]) * _unit_of_spread(fleet, k),
                "between_motors_sd": _number(found.spreads.sd[0, k] * _unit_of_spread(fleet, k)),
                "between_motors_likely": float(found.between[k]) * _unit_of_spread(fleet, k),
                "between_recordings": float(found.spreads.psi[k] * found.spreads.told[1, k]) * _unit_of_spread(fleet, k),
            }
            for k, key in enumerate(found.keys)
        },
        "motors": [
            {
                **({"diagnosis": dict(fleet.diagnoses[name])} if name in fleet.diagnoses else {}),
                "motor": name, "oddness": float(found.oddness[m]), "odd": bool(found.differences[m]),
                "differences": [_difference_json(fleet, d) for d in found.differences[m]],
                "alone": {key: float(alone[m, k]) for k, key in enumerate(found.keys)},
                "parameters": {
                    key: {
                        "value": float(values[m, k]), "sd": float(sds[m, k]),
                        "interval_95": [float(low[m, k]), float(high[m, k])],
                    }
                    for k, key in enumerate(found.keys)
                },
            }
            for m, name in enumerate(found.motors)
        ],
        "changes": [
            {
                "motor": s.motor, "parameter": s.key, "unit": s.unit, "kind": s.change.kind, "size": s.change.size,
                "sd": s.change.sd, "since": s.dates[s.change.at].isoformat(), "p": s.change.p,
                "probability": s.change.probability,
            }
            for s in changed(fleet) if s.change is not None
        ],
        "recordings": [
            {
                "recording": o.entry.name, "motor": o.entry.motor,
                "date": o.entry.date.isoformat() if o.entry.date else None,
                **({"failed": o.failure} if o.failure else {"result": o.key, "adds_bits": float(adds[next(used)])}),
            }
            for o in fleet.outcomes
        ],
    }  # fmt: skip


def to_html(fleet: Fleet, motor: str, command: str) -> Page:
    """The page."""
    found = fleet.population
    summary = _in_common(fleet)
    summary.append(
        f"Fitted from {motor}. A motor is odd if chance would make one so different in one of a hundred fleets, all "
        "motors and parameters counted; odd motors take no part in the population."
    )
    if fleet.failed:
        empty = sum(bool(outcome.entry.lacks) for outcome in fleet.failed)
        spoilt = len(fleet.failed) - empty
        lost = [f"{_count(spoilt, 'recording')} could not be used"] if spoilt else []
        lost += [f"{_count(empty, 'folder')} held none"] if empty else []
        summary.append(f"{', '.join(lost)}: listed below.")
    sections = [Section("Odd motors", _odd_content(fleet)), Section("The make", _make_content(fleet))]
    if fleet.diagnoses:
        table = Table(
            ["motor", "what is missing from the make in it"], [list(row) for row in _diagnoses(fleet)]
        )
        sections.append(Section("Diagnoses", [table]))
    if changed(fleet):
        sections.append(Section("What changed", _change_content(fleet)))
    sections += [
        Section("All motors", [_motor_table(fleet)]),
        Section("What each recording adds", _adds_content(fleet)),
    ]
    if fleet.failed:
        rows = [[o.entry.name, o.entry.motor, o.failure] for o in fleet.failed]
        sections.append(
            Section("Recordings that could not be used", [Table(["recording", "motor", "why"], rows)])
        )
    return Page(f"motorlens fleet: {found.file.name}", verdict(fleet), summary, sections, [command])


def make_sentence(fleet: Fleet, effect: MakeEffect) -> str:
    """What all motors, or the sensors with which they were recorded, have that the motor file lacked."""
    found = fleet.population
    k = found.keys.index(effect.key)
    value, sd = found.mean()[0][k], found.mean()[1][k]
    unit = unit_text(found.file.meaning(effect.key).unit)
    size = f"{significant(float(value))} +- {sd:.2g} {unit}".rstrip()
    helped = f"it helps {100 * effect.share:.0f} % of the motors asked"
    whose = "All were recorded with" if effect.of_sensor else "The make has"
    return f"{whose} {_names(effect.key, effect.alike)}: {size}; {helped}."


def _diagnoses(fleet: Fleet) -> list[tuple[str, str]]:
    """Motors that were diagnosed, and the verdict of each in a sentence."""
    return [
        (motor, str(said.get("sentence") or f"could not be diagnosed: {said['failed']}"))
        for motor, said in fleet.diagnoses.items()
    ]


def _in_common(fleet: Fleet) -> list[str]:
    """What all have in common, a sentence each."""
    lacks = fleet.population.lacks
    more = [] if lacks is None else [f"Most motors also show {_names(lacks.key, lacks.alike)}."]
    if away := led_away(fleet):
        unit = {key: unit_text(fleet.population.file.meaning(key).unit) for key in away}
        sizes = ", ".join(f"{key} {significant(sd)} {unit[key]}".rstrip() for key, sd in away.items())
        seconds = fleet.make.brief_s
        more.append(
            f"The first {seconds:g} s of a recording alone lead away from its motor by (one sd): {sizes}."
        )
    return [*(make_sentence(fleet, one) for one in (*fleet.effects, *fleet.faults)), *more]


def led_away(fleet: Fleet) -> dict[str, float]:
    """By how much brief recordings lead away from their motors, in units; empty where nobody asked."""
    return {key: known.brief_sd for key, known in fleet.make.knowledge.items() if known.brief_sd}


def differences(fleet: Fleet, m: int) -> list[str]:
    """By what a motor differs, a sentence each."""
    found, out = fleet.population, []
    for one in found.differences[m]:
        unit = unit_text(_unit(fleet, one))
        since = next(
            (f", since {s.dates[s.change.at]:%Y-%m-%d}" for s in fleet.histories
             if s.motor == found.motors[m] and s.key == one.key and s.change is not None and s.change.kind == "step"), "",
        )  # fmt: skip
        out.append(
            f"{_names(one.key, one.alike)} differs by {one.by:+.3g} +- {one.sd:.2g} {unit}".rstrip() + since
        )
    return out


def changed(fleet: Fleet) -> list[Series]:
    """Histories with a change, the surest first."""
    real = [
        (series.change.p, k, series) for k, series in enumerate(fleet.histories) if series.change is not None
    ]
    return [series for _, _, series in sorted(real, key=lambda one: one[:2])]


def change_sentence(series: Series) -> str:
    """What changed, when and by how much."""
    seen, unit = series.change, unit_text(series.unit)
    assert seen is not None
    size = f"{seen.size:+.3g} +- {seen.sd:.2g} {unit}".rstrip()
    if seen.kind == "step":
        how = f"at once by {size}, between {series.dates[seen.at - 1]:%Y-%m-%d} and {series.dates[seen.at]:%Y-%m-%d}"
    elif seen.kind == "drift":
        how = f"steadily by {size}, from {series.dates[0]:%Y-%m-%d} to {series.dates[-1]:%Y-%m-%d}"
    else:
        how = f"by about {size}; at once or steadily, the recordings do not tell"
    return f"{series.motor}: {series.key} changed {how} (p = {seen.p:.1g})"


def _odd_content(fleet: Fleet) -> list[str | Table | Bars | Any | Plot]:
    found = fleet.population
    order = np.argsort(-found.oddness, kind="stable")[:SHOWN].tolist()
    bars = [
        Bar(found.motors[m], float(found.oddness[m]), "lacking" if found.differences[m] else "noise")
        for m in order
    ]
    rows = [[found.motors[m], sentence] for m in fleet.odd for sentence in differences(fleet, m)]
    content: list[str | Table | Bars | Any | Plot] = []
    if rows:
        content.append(
            Table(
                ["motor", "differs in"], rows, "Names joined by or: these recordings do not tell them apart."
            )
        )
    content.append(Bars("Oddness", "", bars, "-log10 of the probability that chance makes a motor so unlike the others, "
                        f"all its parameters counted; the oddest {len(bars)} of {len(found.motors)}."))  # fmt: skip
    return content


def _make_content(fleet: Fleet) -> list[str | Table | Bars | Any | Plot]:
    found = fleet.population
    head = ["parameter", "make", "+-", "between motors", "between recordings of one", "unit"]
    caption = (
        "Spreads are standard deviations, relative where a parameter is positive. Where nothing or another spread explains "
        "the recordings as well, twice the root mean square under the likelihood stands instead; not told: that is no less "
        "than what was possible beforehand."
    )
    content: list[str | Table | Bars | Any | Plot] = [Table(head, _population_rows(fleet), caption)]
    values, _ = found.of_motors()
    middle = found.solved.mean
    for k, key in enumerate(found.keys):
        if found.spreads.omega[k] == 0 or len(found.motors) < 3:
            continue
        width = float(np.hypot(found.spreads.omega[k], 1e-9))
        least, most = (found.scale.limits()[:, k] - middle[k]) / width
        span = np.linspace(max(-3.5, least), min(3.5, most), _POINTS)
        at = found.scale.centre[k] + found.scale.size[k] * (middle[k] + width * span)
        motors = np.searchsorted(np.sort(values[:, k]), at, side="right") / len(values)
        unit = unit_text(found.file.meaning(key).unit)
        content.append(curves(
            f"{key}, {unit}" if unit else key, "share of the motors below", at,
            {"motors": ("measured", motors), "population": ("predicted", norm.cdf(span))},
        ))  # fmt: skip
    return content


def _change_content(fleet: Fleet) -> list[str | Table | Bars | Any | Plot]:
    content: list[str | Table | Bars | Any | Plot] = [
        "One change in a hundred motors without any is expected to stand here by chance."
    ]
    for series in changed(fleet)[:SHOWN]:
        days = np.array([(date - series.dates[0]).total_seconds() / 86400 for date in series.dates])
        unit = unit_text(series.unit)
        # A day with two recordings is two points of one curve.
        days = days + 1e-6 * np.arange(len(days))
        content.append(curves(
            f"days since {series.dates[0]:%Y-%m-%d}", f"{series.key}, {unit}" if unit else series.key, days,
            {series.motor: ("measured", series.value)},
            band=(series.low, series.high),
            caption=change_sentence(series) + ". The band is the 95 % interval of each recording.",
        ))  # fmt: skip
    return content


def _motor_table(fleet: Fleet) -> Table:
    found = fleet.population
    values, sds = found.of_motors()
    told = [k for k in range(len(found.keys)) if found.spreads.omega[k] > 0] or list(range(len(found.keys)))
    head = ["motor", "recordings", "oddness"]
    for k in told:
        unit = unit_text(found.file.meaning(found.keys[k]).unit)
        head += [f"{found.keys[k]}, {unit}" if unit else found.keys[k], "+-"]
    counts = np.bincount(found.data.motor, minlength=len(found.motors))
    rows = []
    for m in np.argsort(-found.oddness, kind="stable").tolist():
        row: list[Any] = [found.motors[m], int(counts[m]), round(float(found.oddness[m]), 1)]
        for k in told:
            row += [float(values[m, k]), f"{sds[m, k]:.2g}"]
        rows.append(row)
    return Table(
        head, rows, "Given all recordings of all motors; parameters whose spread between motors shows."
    )


def _adds_content(fleet: Fleet) -> list[str | Table | Bars | Any | Plot]:
    found, adds = fleet.population, _adds(fleet)
    order = np.argsort(-adds, kind="stable")
    bars = [Bar(found.observations[r].name, float(adds[r])) for r in order[:SHOWN].tolist()]
    least = ", ".join(found.observations[r].name for r in order[::-1][:3].tolist())
    caption = (
        "By how much the recording narrows what is known of its motor, beside the make and the motor's other recordings: "
        f"one bit halves one interval. The least comes from {least}."
    )
    return [Bars("Information", "bit", bars, caption)]


def _adds(fleet: Fleet) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(R,) bits that each recording adds to what is known of its motor without it."""
    found = fleet.population
    psi, identity = found.spreads.psi, np.eye(len(found.keys))
    scaled = psi[:, None] * np.linalg.inv(identity + psi[:, None] * found.data.information * psi) * psi
    own = found.data.information - found.data.information @ scaled @ found.data.information
    known = np.diag(1 / np.maximum(found.between, 1e-6) ** 2)
    whole = found.solved.motor_information[found.data.motor] + known
    bits = np.linalg.slogdet(whole)[1] - np.linalg.slogdet(whole - own)[1]
    return np.asarray(np.maximum(bits, 0.0) / (2 * np.log(2)))


def _population_rows(fleet: Fleet) -> list[list[Any]]:
    found = fleet.population
    mean, sd = found.mean()
    rows = []
    for k, key in enumerate(found.keys):
        rows.append([
            key, float(mean[k]), float(f"{sd[k]:.3g}"), _spread(fleet, 0, k), _spread(fleet, 1, k),
            unit_text(found.file.meaning(key).unit),
        ])  # fmt: skip
    return rows


def _spread(fleet: Fleet, row: int, k: int) -> str:
    found = fleet.population
    told, size = found.spreads.told[row, k], (found.spreads.omega, found.spreads.psi)[row][k]
    likely = float((found.between, found.spreads.likely[1])[row][k])
    # Nothing is reckoned with of one motor, or of one recording of each.
    if not told and (likely == 0 or 2 * likely >= possible(found.known)[k]):
        return "not told"
    unit = _unit_of_spread(fleet, k)

    def shown(value: float) -> str:
        if not found.scale.relative[k]:
            return f"{value * unit:.2g}"
        percent = 100 * value * unit
        return f"{percent:.2g} %" if percent < 99.5 else f"{percent:.0f} %"

    return shown(float(size)) if told else f"below {shown(2 * likely)}"


def _unit_of_spread(fleet: Fleet, k: int) -> float:
    """What a spread of 1 on the scale is: a share of the make's value, or a number in the parameter's unit."""
    found = fleet.population
    size = float(found.scale.size[k])
    return size / abs(float(found.mean()[0][k])) if found.scale.relative[k] else size


def _names(key: str, alike: tuple[str, ...]) -> str:
    return " or ".join(name.rpartition(".")[0].replace("_", " ") or name for name in (key, *alike))


def _unit(fleet: Fleet, one: Difference) -> str:
    return fleet.population.wide.file.meaning(one.key).unit


def _difference_json(fleet: Fleet, one: Difference) -> dict[str, Any]:
    return {
        "parameter": one.key,
        "by": one.by,
        "sd": one.sd,
        "unit": _unit(fleet, one),
        "gain": one.gain,
        "alike": list(one.alike),
    }


def _effect_json(effect: MakeEffect) -> dict[str, Any]:
    return {"parameter": effect.key, "share": effect.share, "gain": effect.gain, "alike": list(effect.alike)}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
