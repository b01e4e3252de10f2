"""The command that a diagnosis ends with runs as it stands."""

import argparse
import shlex

from motorlens_workbench.commands import add
from motorlens_workbench.report.json import next_command

DOCUMENT = {
    "motor": "my motor.toml", "recordings": ["run 1.csv", "run2.csv"], "chosen": ["dead_current_sensor", "coulomb_friction"],
    "candidates": [{"name": "dead_current_sensor", "gain": 0.0}, {"name": "coulomb_friction", "gain": 40.0}],
}  # fmt: skip


def test_it_is_understood_by_add_and_names_what_can_be_added():
    words = shlex.split(next_command(DOCUMENT))
    parser = argparse.ArgumentParser()
    add.add_arguments(parser)
    given = parser.parse_args(words[2:])
    assert words[:2] == ["motorlens", "add"] and given.effect == "coulomb_friction"
    assert given.motor == "my motor.toml" and given.fit == ["run 1.csv", "run2.csv"]


def test_there_is_none_where_only_a_dead_channel_was_named():
    assert next_command({**DOCUMENT, "chosen": ["dead_current_sensor"]}) == ""
