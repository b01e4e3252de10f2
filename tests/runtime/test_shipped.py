"""Models that come with motorlens are found by name, from any folder; a path stays a path."""

from pathlib import Path

import pytest

from motorlens_runtime.errors import ModelError
from motorlens_runtime.files.shipped import motor_path, sensor_path, shipped
from motorlens_runtime.sensor.sensor import load_sensor

ONE_ENGINE = "it is about where files are found"

MODELS = Path(__file__).resolve().parents[2] / "models"


def test_everything_in_models_has_a_name():
    assert set(shipped("motors")) == {file.stem for file in (MODELS / "motors").glob("*.toml")}
    cards = {file.stem for file in (MODELS / "sensors").glob("*.md")}
    assert set(shipped("sensors")) == cards


def test_a_name_is_found_from_any_folder_and_a_file_of_that_name_comes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert motor_path("mellah2016").read_bytes() == (MODELS / "motors/mellah2016.toml").read_bytes()
    assert load_sensor("mellah2016").name == "mellah2016"
    (tmp_path / "mellah2016").write_text("mine")
    assert motor_path("mellah2016") == Path("mellah2016")


@pytest.mark.parametrize("path", ["other/mellah2016.toml", "mellah2016.toml", "/mellah2016"])
def test_a_path_stays_as_it_stands(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert motor_path(path) == Path(path)


def test_an_unknown_name_says_which_there_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ModelError, match="did you mean 'mellah2016'"):
        motor_path("melah2016")
    with pytest.raises(ModelError, match="there are mellah2016, mellah2016_observer"):
        sensor_path("zzz")
