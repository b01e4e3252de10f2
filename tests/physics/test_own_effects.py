"""A user's own effect, in one file outside the package, works like a built-in one; what is wrong with it is said."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.effect_contract import CONTRACT

from motorlens_physics.effect import catalogue, load_effects
from motorlens_physics.estimate.calibrate import calibrate
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording
from motorlens_physics.scenario import measure, perform, scenarios
from motorlens_physics.simulation import Inputs, simulate
from motorlens_runtime.cli import main
from motorlens_runtime.errors import DataError

PAPER = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"

# The example of the documentation is what is tested.
DOCUMENT = (Path(__file__).resolve().parents[2] / "docs/own-effects.md").read_text(encoding="utf-8")
OWN = DOCUMENT.partition("```python\n")[2].partition("```\n")[0]


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "my_effects.py"
    path.write_text(OWN, encoding="utf-8")
    return path


def test_it_is_found_beside_the_catalogue_and_keeps_the_contract(own):
    (name, effect), *rest = load_effects(own).items()
    assert name == "cubic_drag" and not rest and name not in catalogue()
    for check in CONTRACT:
        check(effect)


def test_it_is_listed(own, capsys):
    assert main(["effects", "cubic_drag", "--effects-from", str(own)]) == 0
    assert "J dw/dt += -c*w^3" in capsys.readouterr().out


def test_it_is_simulated_as_its_closed_form_says(own):
    """A coasting rotor with nothing but cubic drag: w = w0 / sqrt(1 + 2 c w0^2 t / J)."""
    file = read_motor_file(PAPER)
    effect = load_effects(own)["cubic_drag"](c=1e-6)
    motor = file.motor.with_effect(effect)
    coasting = motor.__class__(**{**vars(motor), "ke": 1e-6, "b": 0.0, "R_a0": 1e4})
    time = np.linspace(0.0, 5.0, 501)
    still = np.zeros_like(time)
    speed = simulate(coasting, Inputs(time, still, still, still + 20.0), {"w": 200.0}).speed_rad_s
    expected = 200.0 / np.sqrt(1 + 2 * 1e-6 * 200.0**2 * time / file.motor.J)
    np.testing.assert_allclose(speed, expected, rtol=1e-4)


def test_the_command_simulates_with_it(own, tmp_path):
    arguments = ["simulate", str(PAPER), "--scenario", "no_load_steps", "--effects-from", str(own)]
    ends = []
    for c in ("0", "2e-7"):
        output = str(tmp_path / f"{c}.csv")
        assert (
            main(
                [
                    *arguments,
                    "--effect",
                    f"cubic_drag.c={c}",
                    "-o",
                    output,
                    "--json",
                    str(tmp_path / "s.json"),
                ]
            )
            == 0
        )
        ends.append(json.loads((tmp_path / "s.json").read_text())["maximum"]["speed"])
    assert 0.5 < ends[0] - ends[1] < 50.0
    assert len(read_recording(tmp_path / "0.csv")) > 100


def test_a_motor_file_holds_it(own, tmp_path):
    text = (
        PAPER.read_text(encoding="utf-8")
        + '\n[effects.cubic_drag]\nc = { value = 1e-7, unit = "N*m*s^3/rad^3" }\n'
    )
    (tmp_path / "motor.toml").write_text(text, encoding="utf-8")
    file = read_motor_file(tmp_path / "motor.toml", load_effects(own).values())
    assert file.values()["cubic_drag.c"] == 1e-7


def test_its_size_is_found_by_calibration(own):
    file = read_motor_file(PAPER)
    effect = load_effects(own)["cubic_drag"]
    rng = np.random.default_rng(2)
    truth = replace(file, motor=file.motor.with_effect(effect(c=2e-8)))
    data = measure(
        perform(truth, scenarios()["no_load_steps"](), rng), (), {"current": 0.02, "speed": 0.4}, rng
    )
    started = replace(file, motor=file.motor.with_effect(effect.at_null(file.rated)))
    found = calibrate(started, [data], ["cubic_drag.c"], held=True)
    assert found.converged
    assert abs(found.value["cubic_drag.c"] - 2e-8) < 4 * found.sd["cubic_drag.c"] < 2e-9


def test_it_travels_to_another_process(own):
    effect = load_effects(own)["cubic_drag"](c=1e-7)
    assert pickle.loads(pickle.dumps(effect)) == effect


MISTAKES = {
    "not Python": ("def (:\n", "line 1: not Python"),
    "does not run": ("import nowhere_to_be_found\n", "does not run: ModuleNotFoundError"),
    "nothing in it": ("x = 3\n", "defines no effect"),
    "no decorator": (OWN.replace("@dataclass(frozen=True)\n", ""), "not a frozen dataclass"),
    "not frozen": (OWN.replace("(frozen=True)", ""), "does not run: TypeError"),
    "no balance": (OWN.replace("def torque(", "def stiction("), "enters no balance"),
    "no switch": (OWN.replace(", null=0.0", ""), "needs exactly one parameter with null"),
    "a name that is taken": (
        OWN.replace("CubicDrag", "QuadraticDrag"),
        "quadratic_drag is already in the catalogue",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named_with_the_file(mistake, tmp_path):
    text, said = MISTAKES[mistake]
    path = tmp_path / "my_effects.py"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError) as caught:
        load_effects(path)
    assert said in str(caught.value) and "my_effects.py" in str(caught.value)


def test_a_file_that_is_not_there():
    with pytest.raises(DataError, match="no such file"):
        load_effects("nowhere.py")
