"""Motors diagnosed as jobs of the queue: from what could be used, by content, on the page; one failure stops nothing."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.drawn_fleet import drawn, fleet_of
from helpers.plain_fleet import World, write

from motorlens_physics.effect import catalogue
from motorlens_physics.motor_file import Knowledge, read_motor_file
from motorlens_physics.queue import Done
from motorlens_physics.sensor_model import sensor_catalogue
from motorlens_runtime.errors import DataError
from motorlens_workbench.fleet.diagnosis import Diagnosis, diagnosed
from motorlens_workbench.fleet.store import Store
from motorlens_workbench.fleet.work import Job, analysed
from motorlens_workbench.report.fleet import to_html, to_json, to_text


@pytest.mark.fit
def test_the_odd_ones_are_diagnosed_from_what_could_be_used(tmp_path):
    file = read_motor_file("mellah2016")
    fleet = fleet_of(file, drawn(np.random.default_rng(5), 0.0)[0])
    for outcome in fleet.outcomes:
        (tmp_path / outcome.entry.motor).mkdir(exist_ok=True)
        (tmp_path / outcome.entry.name).write_text(outcome.entry.name, encoding="ascii")
    there = [replace(o, entry=replace(o.entry, path=tmp_path / o.entry.name)) for o in fleet.outcomes]
    fleet = replace(fleet, outcomes=tuple(there))
    asked = []

    def work(jobs):
        for number, job in enumerate(jobs):
            asked.append((job.file, job.paths))
            sentence = {"sentence": "Coulomb friction is missing."}
            yield Done(number, sentence) if number else Done(number, None, "the model cannot be simulated")

    found = diagnosed(fleet, ["m00", "m11"], Job(tmp_path, file), Store(tmp_path / "results"), work)
    assert found == {
        "m00": {"failed": "the model cannot be simulated"},
        "m11": {"sentence": "Coulomb friction is missing."},
    }
    # Beside the make, and of m00 without the recording that is spoilt.
    assert all(one == fleet.make for one, _ in asked)
    assert [path.name for path in asked[0][1]] == [f"{r}.csv" for r in range(5)]
    told = replace(fleet, diagnoses=found)
    page = "".join(to_html(told, "mellah2016", "motorlens fleet"))
    assert "Coulomb friction is missing." in page and "could not be diagnosed: the model cannot" in page
    assert "m11: Coulomb friction is missing." in to_text(told)
    said = {motor["motor"]: motor.get("diagnosis") for motor in to_json(told, "mellah2016")["motors"]}
    assert said["m11"] == found["m11"] and said["m00"] == found["m00"] and said["m01"] is None
    assert "Diagnoses" not in "".join(to_html(fleet, "mellah2016", "motorlens fleet"))


@pytest.mark.fit
def test_a_diagnosis_names_no_path_and_no_time(tmp_path):
    path = tmp_path / "a.csv"
    write(World(1, 1, samples=200, dwell=50).recorded(0, 0, 5), path)
    file = read_motor_file("mellah2016")
    job = Diagnosis((Job(path, file),), file)
    found = analysed(job)
    assert found["verdict"] in {"named", "group", "unknown", "sensor_fault", "adequate", "not_testable"}
    assert str(tmp_path) not in json.dumps(found, allow_nan=False)
    assert found["sentence"] and set(found["error"]["before"]) == {"current", "speed", "temperature"}
    # The same content elsewhere is the same result; another make is not.
    (tmp_path / "elsewhere").mkdir()
    copy = tmp_path / "elsewhere" / "b.csv"
    copy.write_bytes(path.read_bytes())
    assert Diagnosis((Job(copy, file),), file).key() == job.key()
    assert replace(job, file=file.with_values({"R_a0": 4.0})).key() != job.key()


def test_a_result_follows_from_what_the_motor_file_says_not_from_how(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time_s,voltage_V\n", encoding="utf-8")
    file = read_motor_file("mellah2016")
    key = Job(path, file).key()
    assert Job(path, replace(file, text="# again\n" + file.text)).key() == key
    others = [
        file.with_values({"ke": file.motor.ke * (1 + 1e-15)}),
        file.with_values({}, {"ke": Knowledge(0.01)}),
        replace(file, motor=file.motor.with_effect(catalogue()["coulomb_friction"].at_null(file.rated))),
        replace(file, sensors=(sensor_catalogue()["speed_sensor_gain"],)),
        replace(file, rated=replace(file.rated, ambient_C=21.0)),
        replace(file, name="another"),
    ]
    assert len({key, *(Job(path, other).key() for other in others)}) == 1 + len(others)


def test_what_cannot_be_diagnosed_is_said_without_paths(tmp_path):
    class Broken(Diagnosis):
        def result(self):
            raise DataError(f"{self.paths[1]}: no column holds a voltage")

    jobs = tuple(Job(tmp_path / name, read_motor_file("mellah2016")) for name in ("a.csv", "b.csv"))
    assert analysed(Broken(jobs, jobs[0].file))["failed"] == "b.csv: no column holds a voltage"
