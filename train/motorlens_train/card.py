"""The card: what a sensor is, what it was trained on and how wrong it was, as a page for people."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from motorlens_train.sensor import Sensor


def write_card(sensor: Sensor, card: Mapping[str, Any], path: Path) -> None:
    """Write `NAME.md` beside the sensor."""
    path.write_text(card_text(sensor, card), encoding="utf-8")


def card_text(sensor: Sensor, card: Mapping[str, Any]) -> str:
    """The card in Markdown."""
    specification = sensor.specification
    rate, fence = specification.rate, specification.envelope
    lines = [
        f"# {sensor.name}",
        "",
        f"A virtual sensor: {', '.join(f'{o.name} ({o.unit})' for o in specification.outputs)} from "
        f"{' and '.join(specification.document()['inputs'])}.",  # type: ignore[arg-type]
        "",
        *_origin(card),
        f"- For {rate.minimum:g} to {rate.maximum:g} samples a second (nominal {rate.nominal:g}), "
        f"{fence.voltage_V[0]:.4g} to {fence.voltage_V[1]:.4g} V, {fence.current_A[0]:.4g} to {fence.current_A[1]:.4g} A.",
        "",
    ]
    tables = {f"{card['unseen_cycles']} duty cycles not trained on": card["unseen"]}
    if "training" in card:
        tables["the recordings it was trained on"] = card["training"]
    tables |= card.get("cases", {})
    lines += [
        "| errors on | output | rms | largest | worst cycle's rms | 95 % interval covers |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    paper = card.get("paper")
    if paper:
        tables["the paper's protocol: one run, samples split at random 50/25/25, a network of its own"] = (
            paper["table"]
        )
        tables["the same, after the first five seconds"] = paper["steady"]
    units = {o.name: o.unit for o in specification.outputs}
    for title, table in tables.items():
        for name, figures in table.items():
            covered = f"{100 * figures['coverage_95']:.1f} %" if "coverage_95" in figures else "-"
            lines.append(
                f"| {title} | {name} | {figures['rmse']:g} {units[name]} | {figures['max']:g} | "
                f"{figures['worst_cycle_rmse']:g} | {covered} |"
            )
    if paper:
        lines += [
            "",
            f"By the paper's protocol a mean square error of 1.6e-4 (scaled) is reached after {paper['iterations']} "
            f"iterations; the paper's training error was as large after 2000 epochs. Training ends at "
            f"{paper['training_error']:.1e}.",
        ]
    return "\n".join([*lines, *_worlds(card)]) + "\n"


def _worlds(card: Mapping[str, Any]) -> list[str]:
    """What it does in worlds that it was not made in, cell by cell."""
    if "worlds" not in card:
        return []
    cells = card["worlds"]["cells"]

    def number(value: float | None, share: bool = False) -> str:
        return "-" if value is None else f"{100 * value:.1f} %" if share else f"{value:g}"

    lines = [
        "",
        f"In {cells[0]['worlds']} worlds drawn from seed {card['worlds']['seed']} (`motorlens evaluate --worlds`): "
        f"confidently wrong in {cells[0]['wrong']}. Errors are medians of the worlds' rms over the samples of good quality.",
        "",
        "| factor | cell | worlds | wrong | good | speed, rad/s | in 95 % | temperature, K | in 95 % |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for cell in cells:
        speed, rise = zip(cell["rms"], cell["coverage_95"], strict=True)
        figures = " | ".join(f"{number(rms)} | {number(share, True)}" for rms, share in (speed, rise))
        lines.append(
            f"| {cell['factor']} | {cell['cell']} | {cell['worlds']} | {cell['wrong']} | {number(cell['good'], True)} | "
            f"{figures} |"
        )
    return lines


def _origin(card: Mapping[str, Any]) -> list[str]:
    """Where it comes from."""
    if "training" not in card:
        counts = ", ".join(f"{count} to {name}" for name, count in card["operations"].items())
        return [
            f"- The physics observer of the motor file, alone: nothing in it is trained. Arithmetic operations: {counts}.",
            f"- Judged on {card['trained_on']}; seed {card['seed']}, {card['samples_seen']} samples.",
        ]
    return [
        f"- Trained on {card['trained_on']}; {card['samples_seen']} samples seen, {card['training_rows']} rows kept.",
        f"- {card['network']}, {card['parameters']} weights of which {card['effective_parameters']:g} effective; "
        f"log evidence {card['log_evidence']:g}; seed {card['seed']}; training {card['stopped']}.",
        f"- Training data SHA-256 {card['training_data_sha256']}.",
    ]
