"""Tasks on Dask: they come back from other processes, a worker that dies loses none, one that always dies loses one."""

import os
from pathlib import Path

import pytest
from helpers.fleet_tasks import task

from motorlens_physics import queue
from motorlens_physics.queue import cluster, worked
from motorlens_runtime.errors import DeviceError

pytest.importorskip("distributed")


@pytest.mark.fit
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_of_two_workers_one_of_which_is_killed(tmp_path, monkeypatch):
    # Starting a worker takes a while; a third one is not needed to see it.
    monkeypatch.setattr(queue, "DEATHS", 1)
    monkeypatch.setattr(queue, "PATIENCE_S", 3.0)
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
    with cluster(workers=2) as client:
        done = {
            one.number: one for one in worked(client, task, [(n, str(tmp_path)) for n in range(9)], retries=0)
        }
    assert sorted(done) == list(range(9))
    assert done[3].failure == "three.csv: cannot be used"
    assert "out of memory" in done[5].failure
    others = [done[n].value for n in (0, 1, 2, 4, 6, 7, 8)]
    assert [value[0] for value in others] == [0, 1, 2, 4, 6, 7, 8]
    assert {value[2] for value in others} == {"1"}
    assert os.getpid() not in {value[1] for value in others}


@pytest.mark.filterwarnings("ignore")
def test_a_scheduler_that_is_not_there(monkeypatch):
    monkeypatch.setattr(queue, "ANSWERS_S", 0.3)
    with pytest.raises(DeviceError, match="no Dask scheduler answers"), cluster("tcp://127.0.0.1:9"):
        pass
