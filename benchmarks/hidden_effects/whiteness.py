"""What a user would try instead of `motorlens diagnose`: a test of whiteness on what the fitted textbook leaves.

The textbook is fitted as `motorlens` does, by simulation; the test is that of Ljung and Box (1978).
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording


def whiteness(paths: list[Path], motor: Path, lags: int = 25) -> dict[str, Any]:
    """Ljung and Box (1978), doi:10.1093/biomet/65.2.297, on what the fitted textbook leaves, at 1 % over all channels.

    `statistic` is the largest mean square correlation over the lags, times the samples: 1 for white noise.
    """
    file = read_motor_file(str(motor))
    runs = prepare_all([read_recording(str(path)) for path in sorted(paths)], file)
    found = estimate(file, runs)
    tests = []
    for run, residual in zip(found.runs, found.fit.residuals, strict=True):
        for channel, e in zip(run.channels, residual.T, strict=True):
            n, e = len(e), e - e.mean()
            r = np.array([e[:-k] @ e[k:] for k in range(1, lags + 1)]) / (e @ e)
            tests.append((float(n * (n + 2) * np.sum(r**2 / (n - np.arange(1, lags + 1)))), channel))
    statistic, channel = max(tests)
    equation = {"current": "electrical", "speed": "mechanical", "temperature": "thermal"}[channel]
    found_any = chi2.sf(statistic, lags) < 0.01 / len(tests)
    return {
        "verdict": "unknown" if found_any else "adequate",
        "chosen": [],
        "groups": [],
        "equation": equation if found_any else None,
        "candidates": [],
        "statistic": statistic / lags,
    }
