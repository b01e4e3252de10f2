"""The demo of `make demo`, shorter: it ends when the motor has run its time, and nothing is said to be wrong then."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.fit
def test_the_demo_ends_with_its_picture_and_no_word_of_a_line_that_broke(tmp_path, monkeypatch, capfd):
    spec = importlib.util.spec_from_file_location("live_demo", ROOT / "examples" / "live_demo.py")
    assert spec is not None and spec.loader is not None
    demo = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(demo)
    monkeypatch.setattr(demo, "ROOT", tmp_path)
    monkeypatch.setattr(demo, "DEVICE_S", 60)
    assert demo.main() == 0
    said = capfd.readouterr()
    assert "plugged in" not in said.err and "the line broke" not in said.err
    assert "0 reconnections" in said.err and "within 2 sd" in said.out
    assert (tmp_path / "out" / "demo.png").stat().st_size > 10_000
