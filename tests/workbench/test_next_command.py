"""The command that a diagnosis ends with runs as it stands."""

import argparse
import shlex

from motorlens_workbench.commands import add
from motorlens_workbench.report.json import next_command

DOCUMENT = {
    "motor": "my motor.toml",
    "recordings": ["run 1.csv", "run2.csv"],
    "options": [
        "--column",
        "voltage=duty*supply [V]",
        "--range",
        "2:8.5",
        "--terminal",
        "current",
        "--driven",
    ],
    "groups": [["dead_current_sensor"], ["stribeck_friction", "coulomb_friction"], ["dead_time"]],
    "candidates": [
        {"name": "dead_current_sensor", "gain": 0.0, "probability": 1.0, "p": 1e-9},
        {"name": "stribeck_friction", "gain": 41.0, "probability": 0.1, "p": 1e-10},
        {"name": "coulomb_friction", "gain": 40.0, "probability": 0.9, "p": 1e-9},
        {"name": "dead_time", "gain": 9.0, "probability": 1.0, "p": 1e-4},
    ],
}


def test_it_is_understood_by_add_and_names_the_likeliest_of_each_group_that_can_be_added():
    words = shlex.split(next_command(DOCUMENT))
    parser = argparse.ArgumentParser()
    add.add_arguments(parser)
    given = parser.parse_args(words[2:])
    assert words[:2] == ["motorlens", "add"] and given.effect == ["coulomb_friction", "dead_time"]
    assert given.motor == "my motor.toml" and given.fit == ["run 1.csv", "run2.csv"]
    assert given.column == ["voltage=duty*supply [V]"] and given.range == ["2:8.5"]
    assert given.terminal == "current" and given.driven


def test_what_is_seen_goes_before_what_is_likelier_and_is_not():
    candidates = [
        {**one, "p": 0.76} if one["name"] == "coulomb_friction" else one for one in DOCUMENT["candidates"]
    ]
    assert shlex.split(next_command({**DOCUMENT, "candidates": candidates}))[2:4] == [
        "stribeck_friction",
        "dead_time",
    ]


def test_what_was_made_better_is_made_better_again_beside_it():
    motors = ["mellah2016"]
    for _ in range(3):
        words = shlex.split(next_command({**DOCUMENT, "motor": motors[-1]}))
        motors.append(words[words.index("-o") + 1])
    assert len(set(motors)) == 4, motors


def test_there_is_none_where_only_a_dead_channel_was_named():
    assert next_command({**DOCUMENT, "groups": [["dead_current_sensor"]]}) == ""
