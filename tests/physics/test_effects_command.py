"""`motorlens effects`: the list, one effect in full, drawings, JSON and the generated document."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import sympy
from helpers.effect_contract import PLATES

from motorlens_physics import describe
from motorlens_physics.commands.effects import markdown, text_plot
from motorlens_physics.describe import Curve, curves, equation_of, equations, expressions
from motorlens_physics.effect import catalogue
from motorlens_physics.effects.stribeck_friction import StribeckFriction
from motorlens_physics.sensor_model import sensor_models
from motorlens_runtime.cli import main

ROOT = Path(__file__).resolve().parents[2]
PAPER = str(ROOT / "models/motors/mellah2016.toml")


def test_the_list_names_every_effect_and_every_kind_of_sensor_fault_once(capsys):
    assert main(["effects"]) == 0
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines() if re.match(r"  \w", line)]
    faults = [name for name in sensor_models() if name.startswith("current")]
    assert sorted(names) == sorted([*catalogue(), *faults])


def test_typical_sizes_are_those_of_the_plate(capsys):
    main(["effects", "coulomb_friction", "--motor", PAPER])
    assert "typically 0.194 N*m" in capsys.readouterr().out  # 3 % of 6.455 N m


@pytest.mark.parametrize("name", [*catalogue(), "speed_sensor_lag", "current_sensor_noise"])
def test_one_in_full(name, capsys):
    assert main(["effects", name]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"{name} (")
    part = {**catalogue(), **sensor_models()}[name]
    for parameter in part.parameters():
        assert re.search(rf"^  {parameter} ", out, re.MULTILINE)


@pytest.mark.fit
@pytest.mark.parametrize("suffix, start", [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_draws(suffix, start, tmp_path):
    path = tmp_path / f"term.{suffix}"
    assert main(["effects", "brush_voltage_drop", "-o", str(path)]) == 0
    assert path.read_bytes().startswith(start)


@pytest.mark.parametrize(
    "arguments, hint",
    [
        (["stribek_friction"], "did you mean 'stribeck_friction'?"),
        (["coulomb_friction", "-o", "x.bmp"], "drawn as .png, .svg or .pdf"),
        (["speed_sensor_lag", "-o", "x.png"], "only effects are drawn"),
        (["-o", "x.png"], "give its NAME"),
        (["--effects-from", "nowhere.py"], "no such file"),
    ],
)
def test_mistakes_get_one_line(arguments, hint, capsys):
    assert main(["effects", *arguments]) == 1
    said = capsys.readouterr().err
    assert hint in said and said.count("\n") == 1


def test_json_holds_all_that_is_said(capsys):
    assert main(["effects", "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [effect["name"] for effect in document["effects"]] == list(catalogue())
    assert len(document["sensors"]) == len(sensor_models())
    for effect in document["effects"]:
        assert effect["references"] and effect["summary"] and effect["equations"] and effect["latex"]
        assert sum(parameter["null"] is not None for parameter in effect["parameters"]) == 1


def test_the_document_is_current():
    written = (ROOT / "docs/effects.md").read_text(encoding="utf-8")
    assert written == markdown(catalogue(), sensor_models()), (
        "run: motorlens effects --markdown docs/effects.md"
    )


def test_equations_are_those_of_the_textbook_notation():
    assert equations(catalogue()["coulomb_friction"]) == ["J dw/dt += -tau_c*tanh(w/w_s)"]
    assert equations(catalogue()["quadratic_drag"]) == ["J dw/dt += -c*w*|w|"]
    assert equations(catalogue()["unbalance_torque"]) == ["J dw/dt += -A*sin(p + phi)", "dphi/dt = w"]


def test_printed_expressions_have_the_values_of_the_code():
    """Rounding off |w| is the only thing the print leaves out, and it is below 1e-3 rad/s."""
    rated = PLATES[0]
    for effect in catalogue().values():
        e = effect.typical(rated)
        for curve in curves(e, rated):
            expression = expressions(effect)[curve.term]
            points = describe._rated_points(e, rated)
            values = {name: top for name, (_, top, _) in points.items()} | {
                name: getattr(e, name) for name in effect.parameters()
            }
            motor = {s.name for s in expression.free_symbols} - set(values)
            values |= {name: getattr(describe.Motor(), name.removesuffix("_motor")) for name in motor}
            for k in (0, 130, 400):
                at = values | {curve.x_name: curve.x[k]}
                printed = float(expression.subs({s: at[s.name] for s in expression.free_symbols}))
                np.testing.assert_allclose(
                    curve.y[k], printed, rtol=1e-3, atol=2e-4 * np.max(np.abs(curve.y))
                )


def test_every_effect_is_in_the_equation_its_methods_say():
    groups = {name: equation_of(effect) for name, effect in catalogue().items()}
    assert set(groups.values()) == set(describe.EQUATIONS)
    assert groups["brush_voltage_drop"] == groups["inductance_saturation"] == "electrical"
    assert groups["magnet_temperature"] == groups["armature_reaction"] == "coupling"
    assert groups["coulomb_friction"] == groups["hysteresis_iron_loss"] == "mechanical"
    assert groups["two_node_thermal"] == groups["radiation"] == "thermal"


def test_a_curve_that_lives_near_rest_is_drawn_there():
    (curve,) = curves(StribeckFriction.typical(describe.PLATE), describe.PLATE)
    peak = curve.x[np.argmax(curve.y)]
    assert -curve.x[-1] < peak < 0
    assert 0.05 < abs(peak) / curve.x[-1] < 0.95


def test_text_plot_puts_a_line_on_the_diagonal():
    x = np.linspace(-1.0, 1.0, 9)
    lines = text_plot(Curve("y", "x", "m", "N", x, 2 * x), width=9, height=9).splitlines()
    stars = [line.partition("|")[2] for line in lines[1:10]]
    assert [row.index("*") for row in stars] == list(range(8, -1, -1))
    assert lines[1].split()[0] == "2" and lines[9].split()[0] == "-2" and lines[5].endswith("*----") is True


def test_latex_is_latex():
    assert sympy.latex(expressions(catalogue()["coulomb_friction"])["J dw/dt"]) == (
        r"- \tau_{c} \tanh{\left(\frac{w}{w_{s}} \right)}"
    )
